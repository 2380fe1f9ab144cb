"""Packages of others that commands know."""

from importlib.metadata import entry_points

from bra.cli.errors import fail


def load_plugins() -> None:
    """Imports what entry points of the group `bra.plugins` name; their classes have short names.

    One that cannot be imported ends the command in a line that names it.
    """
    for plugin in entry_points(group="bra.plugins"):
        try:
            plugin.load()
        except Exception as error:  # whatever code of others raises
            package = plugin.dist.name if plugin.dist else plugin.value
            fail(
                f"plugin {plugin.name} of {package} cannot be imported: "
                f"{type(error).__name__}: {error}; mend or uninstall it"
            )
