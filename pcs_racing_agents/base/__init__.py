"""Long work on any executor that can be stopped and resumed.

A *job* is a folder in which long work is done (:mod:`.jobs`, :mod:`.folders`). Its work consists of *tasks*: calls of a
function with one argument each (:mod:`.tasks`). Tasks with the same function form a *group*. The result of a task is
kept in a *chunk*, a file of arrays (:mod:`.chunks`). An *executor* says where tasks run (:mod:`.executors`).

Functions of this package that take long have up to three arguments for this, which their docstrings do not repeat.
``job`` keeps results, so that a stopped run can be resumed; without one nothing is kept. ``executor`` says where tasks
run; without one they run in this process, on all cores. Neither changes the result. ``progress`` is called as
``progress(done, total, label)``; :func:`pcs_racing_agents.base.progress.show_progress` makes one that prints a line.
"""
