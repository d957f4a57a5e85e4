"""Exit of commands at errors of files and of the machine, and progress where there is no terminal."""

import time

import pytest
import typer

from graphtrack.cli import console
from graphtrack.cli.console import progress_bar, run_app


def failing(error: BaseException) -> typer.Typer:
    """A program whose command raises an error."""
    app = typer.Typer()

    @app.command()
    def fail() -> None:
        raise error

    return app


@pytest.mark.parametrize("error", [EOFError("Ran out of input"), OSError("a broken cable"), MemoryError()])
def test_errors_of_files_and_of_the_machine_are_one_line(error, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["program"])
    with pytest.raises(SystemExit, match="2"):
        run_app(failing(error), "program")
    (line,) = capsys.readouterr().err.split()[:1]  # Typer ends the line after EOFError
    assert line == "error:"


def test_only_an_interrupt_is_an_interrupt(monkeypatch) -> None:
    monkeypatch.setattr("sys.argv", ["program"])
    with pytest.raises((KeyboardInterrupt, SystemExit), match=r"130|^$"):  # depends on Typer's version
        run_app(failing(KeyboardInterrupt()), "program")
    with pytest.raises(ZeroDivisionError):
        run_app(failing(ZeroDivisionError()), "program")


def test_progress_in_a_pipe_is_a_line_now_and_then(monkeypatch, capsys) -> None:
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with progress_bar(3000) as advance:
        for _ in range(3):
            clock[0] += 0.6 * console._REPORTED_AFTER
            advance(1000)
    assert capsys.readouterr().err == "2,000 of 3,000 person-frames …\n"
    with progress_bar(None, "parts") as advance:
        advance(0, 4)
        clock[0] += console._REPORTED_AFTER
        advance(1)
    assert capsys.readouterr().err == "1 of 4 parts …\n"
