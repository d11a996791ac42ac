"""`lfgpu doctor`: what is installed here, what it runs on, and whether it computes what it should."""

import typer


def doctor() -> None:
    """Examine this installation: versions, devices, kernels, memory, optional parts, and a self-test with a verdict.

    The self-test estimates a small scene on every device and compares the map with the ground truth and with the
    reference backend. It takes about ten seconds; the first run compiles kernels and takes longer. The exit code is 1
    if something does not work.
    """
    from lfgpu.cli.checkup import examine
    from lfgpu.cli.console import heading, lines, output, remark, waiting

    with waiting("testing every device on a small scene"):
        found = examine()
    console = output()
    for title, facts in found.facts.items():
        heading(console, title)
        lines(console, facts)
    heading(console, "Verdict")
    for sentence in found.problems or ("Everything that is installed works.",):
        remark(console, sentence)
    if found.problems:
        raise typer.Exit(1)
