"""TensorBoard's page of curves that are laid over each other."""

from collections.abc import Mapping, Sequence

from lightning.pytorch.loggers import TensorBoardLogger

from bra.callbacks.events import write


def lay_over(logger: TensorBoardLogger, charts: Mapping[str, Sequence[str]]) -> None:
    """Adds a chart for each title, of curves by their tags, to the page *Custom Scalars*.

    The first chart is a category of its own, which the page keeps on top; those of a category it
    shows from the last to the first.

    The first curve has squares, then come diamonds, triangles, stars and crosses. Charts of several
    tags would have them in an order that changes from visit to visit; so every curve is one with
    margins, which are of no width.
    """
    from tensorboard.compat.proto.summary_pb2 import Summary, SummaryMetadata
    from tensorboard.compat.proto.tensor_pb2 import TensorProto
    from tensorboard.compat.proto.tensor_shape_pb2 import TensorShapeProto
    from tensorboard.plugins.custom_scalar import layout_pb2, metadata

    series = layout_pb2.MarginChartContent.Series
    contents = {
        title: layout_pb2.MarginChartContent(
            series=[series(value=t, lower=t, upper=t) for t in tags]
        )
        for title, tags in charts.items()
    }
    first, *others = (
        layout_pb2.Chart(title=title, margin=content) for title, content in contents.items()
    )
    layout = layout_pb2.Layout(
        category=[
            layout_pb2.Category(title="objective", chart=[first]),
            layout_pb2.Category(title="terms", chart=others[::-1]),
        ]
    )
    tensor = TensorProto(
        dtype="DT_STRING",
        string_val=[layout.SerializeToString()],
        tensor_shape=TensorShapeProto(),
    )
    plugin = SummaryMetadata.PluginData(plugin_name=metadata.PLUGIN_NAME)
    value = Summary.Value(
        tag=metadata.CONFIG_SUMMARY_TAG,
        tensor=tensor,
        metadata=SummaryMetadata(plugin_data=plugin),
    )
    write(logger, Summary(value=[value]))
