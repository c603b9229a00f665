"""The two problems that navgym comes with, for tests of what is true of one of them."""

from navgym.problem import problem_of

AUV, DECK = (problem_of(name).environment.id for name in ("auv", "deck"))
run, run_deck = problem_of("auv").run, problem_of("deck").run
