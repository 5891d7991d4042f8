"""Which rows of a table of numbers are equal: `numpy.unique` along the first axis, several times faster."""

import numpy as np
from jaxtyping import Int, Num


def distinct_rows(rows: Num[np.ndarray, "n column"]) -> tuple[Int[np.ndarray, " distinct"], Int[np.ndarray, " n"]]:
    """(index of the first of each distinct row, in ascending order of rows; which of these each row equals).

    The same as `return_index` and `return_inverse` of `numpy.unique(rows, axis=0)`, which compares whole rows as one
    record. `rows` holds no NaN and at least one column.
    """
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    begins = np.ones(len(rows), dtype=bool)
    begins[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = np.cumsum(begins) - 1
    return order[begins], place
