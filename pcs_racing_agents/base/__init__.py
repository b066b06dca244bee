"""Long work on any executor, with stop and resume.

A *job* is a folder for long work (:mod:`.jobs`, :mod:`.folders`). Its work consists of *tasks*:
calls of a function with one argument each (:mod:`.tasks`). Tasks with the same function form a
*group*. The result of a task is stored in a *chunk*, a file of arrays (:mod:`.chunks`). An
*executor* runs the tasks (:mod:`.executors`).

Long-running functions of this package share up to three arguments, which their docstrings do not
repeat. ``job`` saves results, so that a stopped run can be resumed; without a job nothing is saved.
``executor`` runs the tasks; without an executor they run in this process, on all cores. Neither
changes the result. ``progress`` is called as ``progress(done, total, label)``;
:func:`pcs_racing_agents.base.jobs.show_progress` makes a function that prints a line.
"""
