"""``hexmap plan`` in four rooms: what is asked, the map it is asked of, the search, the command."""
