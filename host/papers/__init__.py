"""The published sensors' own methods, benches and experiments, one package a paper, named as its board.

`method` is the paper's, plainly in float, with its equations by their numbers; `bench` judges it on the twin as the
paper does, `experiment` ours beside it. Not in the wheel: nothing that ships imports them.
"""
