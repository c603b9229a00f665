"""Columns that every engine's kernels write; numbers are frozen into kernels."""

# the first columns of a decision's outcome, in every engine; information follows
REWARD, TERMINATED, TRUNCATED, INFORMATION = range(4)

# what a live lane adds up between two decisions: samples in which something was received, NIS of the
# controlled filter, its degrees of freedom, how well both filters foretold what came in, and how far both
# missed position fixes, where there are any
HEARD, NIS_SUM, FREEDOM, SCORE, REFERENCE_SCORE, MISS, REFERENCE_MISS = range(7)
TALLY = 7
