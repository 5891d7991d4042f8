"""The margins of many force balances by HiGHS at once: those of `problem_margin`, for a fraction of the computing."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linprog
from scipy.sparse import block_array, block_diag, coo_array, eye_array

from dexnudge.mechanics.balance import BISECTIONS, MAX_FACTOR, SCAN_STEP, BalanceProblem
from dexnudge.mechanics.friction_cone import EDGE_COUNT

BATCH = 200  # problems of one linear program
FEASIBLE = 1e-7  # what may be missing of a balance, in weights: HiGHS's own tolerance
ROUNDING = 1e-12  # of a certificate's product with a column


class HighsMargins:
    """Where `problems` are feasible, by the least sum of forces and torques that are missing, and by Farkas' alternative.

    The duals y of such a program prove that a problem is infeasible, also at every other factor at which y is at most 0
    on all its columns; there, nothing is solved.
    """

    def __init__(self, problems: Sequence[BalanceProblem]) -> None:
        self.problems = problems
        self.certificates = np.full((len(problems), 6), np.nan)

    def margins(self) -> Float[np.ndarray, "problem"]:
        """Return the largest factor in [0, 3] at which each is feasible: scanned from above, then halved."""
        margins = np.zeros(len(self.problems))
        rows = np.flatnonzero([not problem.blocked for problem in self.problems])
        refined = []
        for step in range(round(MAX_FACTOR / SCAN_STEP), -1, -1):
            found = self.feasible(rows, np.full(len(rows), step * SCAN_STEP))
            margins[rows[found]] = step * SCAN_STEP
            refined.append(rows[found])
            rows = rows[~found]
        rows = np.concatenate(refined[1:])
        for halving in range(1, BISECTIONS + 1):
            higher = margins[rows] + SCAN_STEP / 2**halving
            margins[rows] = np.where(self.feasible(rows, higher), higher, margins[rows])
        return margins

    def feasible(self, rows: Int[np.ndarray, "row"], factors: Float[np.ndarray, "row"]) -> Bool[np.ndarray, "row"]:
        """Return which of the problems are feasible, each at its factor."""
        found = np.zeros(len(rows), dtype=bool)
        unproven = np.flatnonzero([not self._proven(*each) for each in zip(rows, factors, strict=True)])
        for first in range(0, len(unproven), BATCH):
            part = unproven[first : first + BATCH]
            missing, duals = _missing([self.problems[row] for row in rows[part]], factors[part])
            found[part] = missing <= FEASIBLE
            self.certificates[rows[part]] = np.where(found[part, None], self.certificates[rows[part]], duals)
        return found

    def _proven(self, row: int, factor: float) -> bool:
        problem = self.problems[row]
        products = (problem.support_normal + factor * problem.support_friction) @ self.certificates[row]
        return not np.isnan(self.certificates[row, 0]) and bool((products <= ROUNDING).all())


def _missing(
    problems: Sequence[BalanceProblem], factors: Float[np.ndarray, "problem"]
) -> tuple[Float[np.ndarray, "problem"], Float[np.ndarray, "problem 6"]]:
    """Return the least sum of what would have to be added for a balance, and the duals of the balance."""
    columns, caps = [], []
    for problem, factor in zip(problems, factors, strict=True):
        hand = problem.hand.reshape(-1, 6)
        columns.append(np.concatenate([hand, problem.support_normal + factor * problem.support_friction]).T)
        links = np.arange(int(problem.link.max()) + 1 if len(problem.link) else 0)
        of_links = np.repeat(problem.link, EDGE_COUNT) == links[:, None]
        caps.append(np.pad(of_links, ((0, 0), (0, columns[-1].shape[1] - len(hand)))).astype(float))
    forces, capped, rest = block_diag(columns), block_diag(caps), eye_array(6 * len(problems))
    unlimited = coo_array((capped.shape[0], 2 * rest.shape[0]))
    result = linprog(
        np.repeat([0.0, 1.0], [forces.shape[1], 2 * rest.shape[0]]),
        A_ub=block_array([[capped, unlimited]]),
        b_ub=np.repeat([problem.cap for problem in problems], [len(each) for each in caps]),
        A_eq=block_array([[forces, rest, -rest]]),
        b_eq=np.concatenate([-problem.load for problem in problems]),
        options={"presolve": False},  # it costs more than it saves
    )
    assert result.success, result.message
    missing = result.x[forces.shape[1] :].reshape(2, len(problems), 6).sum(axis=(0, 2))
    return missing, result.eqlin.marginals.reshape(-1, 6)
