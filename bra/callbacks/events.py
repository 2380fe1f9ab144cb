"""Events of TensorBoard, written as they are: what is measured at one look is one of them.

By `SummaryWriter.add_scalar` each number would be an event of its own, and by `add_image` a picture
is copied, converted and compressed harder than it is worth.
"""

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

from lightning.pytorch.loggers import Logger, TensorBoardLogger
from PIL.Image import Image

if TYPE_CHECKING:
    from tensorboard.compat.proto.summary_pb2 import Summary


def is_plain(logger: Logger) -> bool:
    """Whether a logger is TensorBoard's, and nobody has changed how it names or logs numbers."""
    return type(logger) is TensorBoardLogger and not logger._prefix


def write_numbers(
    logger: TensorBoardLogger, numbers: Mapping[str, float], updates: int | None
) -> None:
    """Writes numbers by their tags, after so many updates."""
    from tensorboard.compat.proto.summary_pb2 import Summary

    values = [Summary.Value(tag=tag, simple_value=number) for tag, number in numbers.items()]
    write(logger, Summary(value=values), updates)


def write_picture(logger: TensorBoardLogger, tag: str, picture: Image, updates: int) -> None:
    """Writes a picture, after so many updates."""
    from tensorboard.compat.proto.summary_pb2 import Summary

    file = io.BytesIO()
    picture.save(file, "PNG", compress_level=1)
    size = {"width": picture.width, "height": picture.height, "colorspace": 3}
    image = Summary.Image(**size, encoded_image_string=file.getvalue())
    write(logger, Summary(value=[Summary.Value(tag=tag, image=image)]), updates)


def write(logger: TensorBoardLogger, summary: "Summary", updates: int | None = None) -> None:
    """Writes an event, after so many updates; only where the run writes, see `is_global_zero`."""
    logger.experiment._get_file_writer().add_summary(summary, updates)
