"""Long work on any executor that can be stopped and resumed.

A *job* is a folder in which long work is done (:mod:`.jobs`, :mod:`.folders`). Its work consists of *tasks*: calls of a
function with one argument each (:mod:`.tasks`). Tasks with the same function form a *group*; tasks that go on from each
other's state form a *chain*. The result of a task is kept in a *chunk*, a file of arrays (:mod:`.chunks`). An
*executor* says where tasks run (:mod:`.executors`).
"""
