"""Yuan, Su, Shi, Wang, Chen 2015: gradient descent IK ("APPS") on a KUKA KR 210, against Newton-Raphson.

Full title: *Autonomous path planning solution for industrial robot manipulator using backpropagation algorithm*.
`study.run_study` does everything; ``docs/papers/apps.md`` tells the story.

    experiment  the seven motions            compare   Newton-Raphson, settings, learning rates, random starts
    tables      Tables 3 to 6, ours, theirs  errata    the misprints, each with its evidence recomputed
    study       all of it as one record      report    the same as tables for people, and as figures
"""
