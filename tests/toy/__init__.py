"""A third problem, as small as can be: proof that a problem is a folder and a line.

A scalar walks at random, gently or roughly; measurements of where it is get lost. Whoever imports
this package has the problem "toy", in worker processes too: what they unpickle of it imports it.
"""

from navgym.problem import Registered, register

register(
    "toy",
    Registered(
        "tests.toy.problem:PROBLEM", "navgym/ToyWalk-v0", "tests.toy.environment:ToyWalkEnv"
    ),
)
