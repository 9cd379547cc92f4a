"""``hexmap plan`` in four rooms: the query (what is asked), the map source, the search and the command."""
