"""Where stderr is no terminal a long job prints a line now and then, a short one nothing."""

from io import StringIO

from rich.console import Console

from dexnudge.jobs.progress import ProgressLines, progress


def test_lines_are_half_a_minute_apart_and_end_before_the_job_does():
    said, clock = StringIO(), [0.0]
    bars = ProgressLines(console=Console(file=said, markup=False, highlight=False), get_time=lambda: clock[0])
    bar = bars.add_task("objects", total=None)
    for clock[0], done in ((29.9, 1), (30.0, 0), (31.0, 2), (60.9, 3), (61.0, 12345)):
        bars.update(bar, completed=done)
    bars.update(bar, total=20000)
    clock[0] = 100.0
    bars.update(bar, advance=1, description="[x] a very long name of what is done" + " and more" * 20)
    clock[0] = 200.0
    bars.update(bar, completed=20000)
    name = "[x] a very long name of what is done" + " and more" * 20
    assert said.getvalue().splitlines() == ["objects: 2", "objects: 12345", f"{name}: 12346 of 20000"]


def test_hidden_tasks_and_short_jobs_print_nothing(capsys):
    said, clock = StringIO(), [0.0]
    bars = ProgressLines(console=Console(file=said), get_time=lambda: clock[0])
    bar = bars.add_task("training", total=9, visible=False)
    clock[0] = 100.0
    bars.update(bar, completed=5)
    assert said.getvalue() == ""
    with progress() as bars:
        bars.update(bars.add_task("short", total=3), completed=1)
    assert capsys.readouterr().err == ""
