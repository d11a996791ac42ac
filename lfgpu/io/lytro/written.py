"""Contents of a processed container as files that can be read again."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from lfgpu.io.atomic import atomic_folder
from lfgpu.io.description import write_description
from lfgpu.io.lytro.contents import Contents, FocusStack, read_contents
from lfgpu.io.lytro.pictures import confidence_table, decoded, depth_table
from lfgpu.io.lytro.reader import read_lytro
from lfgpu.io.pfm import write_pfm
from lfgpu.io.png import write_png

ABOUT_FILE = "lytro.json"
DEPTH_FILE, CONFIDENCE_FILE = "lambda.pfm", "confidence.pfm"
DESCRIPTION_FILE = "lightfield.toml"


def write_contents(path: Path, out: str | os.PathLike[str]) -> list[tuple[str, str]]:
    """Write what a container holds into a folder; all of it or nothing.

    Parameters
    ----------
    path
        The container.
    out
        The folder, made if missing. Refocused pictures become focus_00.jpg ... (as they are in the file) or
        focus_00.png ... (of a video), views view_00.png ... with a lightfield.toml, Lytro's depth table lambda.pfm and
        confidence.pfm; lytro.json says the rest.

    Returns
    -------
    What was written, as (file, meaning).

    Raises
    ------
    LightFieldError
        If the container is damaged, or the folder cannot be written.
    """
    contents = read_contents(path)
    written: list[tuple[str, str]] = []
    about: dict[str, Any] = {"source": path.name, "contents": contents.summary()}
    with atomic_folder(out) as folder:
        if contents.views is not None:
            written += _write_views(path, folder)
        for number, stack in enumerate(contents.stacks):
            prefix = "focus" if len(contents.stacks) == 1 else f"focus_{number}"
            names = _write_stack(contents, stack, folder, prefix)
            about.setdefault("focal_stacks", []).append(
                [{"file": name, "lambda": value} for name, value in zip(names, stack.lambdas, strict=True)]
            )
            written.append((f"{names[0]} ...", f"{len(names)} pictures focused at λ as {ABOUT_FILE} says"))
        if contents.depth is not None:
            write_pfm(folder / DEPTH_FILE, depth_table(contents.container, contents.depth))
            written.append((DEPTH_FILE, "Lytro's depth table, λ; larger is farther"))
            confidence = confidence_table(contents.container, contents.depth)
            if confidence is not None:
                write_pfm(folder / CONFIDENCE_FILE, confidence)
                written.append((CONFIDENCE_FILE, "Lytro's confidence in it, 0 to 1"))
        if contents.camera is not None:
            about["camera"] = dict(contents.camera.facts())
        (folder / ABOUT_FILE).write_text(json.dumps(about, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    written.append((ABOUT_FILE, "what the container holds, and the camera"))
    return written


def _write_views(path: Path, folder: Path) -> list[tuple[str, str]]:
    light_field = read_lytro(path)
    files = [folder / f"view_{index:02d}.png" for index in range(len(light_field.views))]
    for file, view in zip(files, light_field.views, strict=True):
        write_png(file, view)
    described = replace(light_field, files=tuple(map(str, files)), name=path.stem)
    write_description(described, folder / DESCRIPTION_FILE, source={})
    return [("view_00.png ...", f"{len(files)} views"), (DESCRIPTION_FILE, "where they stand; read the folder")]


def _write_stack(contents: Contents, stack: FocusStack, folder: Path, prefix: str) -> list[str]:
    pictures = stack.pictures
    suffix = "jpg" if pictures.representation == "jpeg" else "png"
    names = [f"{prefix}_{index:02d}.{suffix}" for index in range(pictures.count)]
    if suffix == "jpg":
        for name, section in zip(names, pictures.sections, strict=True):
            (folder / name).write_bytes(contents.container.data(section))
    else:
        for name, picture in zip(names, decoded(contents.container, pictures), strict=True):
            write_png(folder / name, picture)
    return names
