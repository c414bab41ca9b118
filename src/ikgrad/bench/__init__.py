"""Benchmarks: ours and other packages on the same poses, in one run, judged by the same forward kinematics.

Data flow: `targets` makes poses, `peers` wraps packages, `race` times them in turns, `judge` says which answers hold,
`records` is what comes out. `ikgrad.cli.bench` prints it.
"""
