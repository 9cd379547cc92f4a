"""When to repair, when to plan anew, and when to leave the answer to A*, by what earlier searches took."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["NO_BUDGET", "ReplanningPolicy"]

NO_BUDGET = 2**62


@dataclass
class ReplanningPolicy:
    """The decisions of a :class:`planners.Replanner`; each has a policy of its own, which learns from its searches.

    Distances are estimates of the cost from the start to the goal, in any one unit. Planning anew is taken to
    expand fewer cells the nearer the goal is.

    Attributes:
        most_cut: cells cut off beyond which planning anew is cheaper, as a fraction of those it would expand.
        most_changed: the same for cells that changed.
        few: cells; so few are never worth planning anew.
        patience: expansions of a search, to those that planning anew would take, after which a forward A*
            answers. Less bounds the worst repair better, but then moderate ones are not brought to their
            end: in total that took longer.
        least_budget: expansions that a search always gets.
        usual_a_cell: expansions of A* to a cell of the path, at most, until it has been asked.
        first_look: expansions after which, and after each doubling, a look is taken whether the robot is shut in.
        pocket: expansions to one cell of the pocket looked for.
        keep_paths: whether the last path is returned again while no change can have made another cheaper.
        effort: cells expanded when last planned anew.
        effort_distance: the distance then.
        usual: cells that a forward A* expands, 0 while nothing is known of that.
        usual_distance: the distance then.
    """

    most_cut: float = 0.5
    most_changed: float = 0.25
    few: int = 256
    patience: float = 1.5
    least_budget: int = 2048
    usual_a_cell: int = 32
    first_look: int = 2048
    pocket: int = 4
    keep_paths: bool = True
    effort: int = 0
    effort_distance: int = 1
    usual: float = 0.0
    usual_distance: int = 1

    # ------------------------------------------------------------------ decisions

    def plans_anew(self, changed: int, distance: int) -> bool:
        """Tell whether so many changed cells are too many to repair."""
        return changed > max(self.few, self.most_changed * self._expected_anew(distance))

    def cut_limit(self, distance: int) -> int:
        """Return how many cells a repair may cut off before all is planned anew."""
        return int(max(self.few, self.most_cut * self._expected_anew(distance)))

    def search_budget(self, distance: int, *, anew: bool, severed: bool) -> int:
        """Return how many expansions a search gets before A* answers instead.

        Args:
            distance: from the start to the goal.
            anew: whether all is planned anew.
            severed: whether there was no path last time. Where A* found none, the search from the goal
                comes to its end once instead, for later changes.
        """
        if not self.usual or severed:
            return NO_BUDGET
        usual = self._expected_of_astar(distance)
        expected = max(self._expected_anew(distance), usual) if anew else usual
        return int(max(self.patience * expected, self.least_budget))

    # ------------------------------------------------------------------ what it learns

    def note_search(self, expansions: int, distance: int, *, anew: bool, ended: bool) -> None:
        """Note what a search took, and whether it came to its end."""
        if anew and ended:
            self.effort, self.effort_distance = expansions, max(distance, 1)

    def note_path(self, expansions: int, distance: int, cells: int) -> None:
        """Note what planning anew took that found a path of so many cells."""
        self.usual, self.usual_distance = min(expansions, self.usual_a_cell * cells), max(distance, 1)

    def note_astar(self, expansions: int, distance: int) -> None:
        """Note what a forward A* took."""
        # A change near the goal can flood A* as one near the robot does the search from the goal.
        most = 2 * self._expected_of_astar(distance)
        self.usual, self.usual_distance = max(min(expansions, most), 1), max(distance, 1)

    def _expected_anew(self, distance: int) -> float:
        return self.effort * min(distance / self.effort_distance, 1.0)

    def _expected_of_astar(self, distance: int) -> float:
        return self.usual * min(distance / self.usual_distance, 1.0)
