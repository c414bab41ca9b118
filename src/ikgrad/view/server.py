"""The server of a page: it listens where it is told to and nowhere else."""

from __future__ import annotations

import contextlib
import io
import socket
from collections.abc import Iterator
from typing import Any

from ikgrad.errors import ConfigError
from ikgrad.extras import need


def start_server(*, host: str = "127.0.0.1", port: int = 8080, label: str | None = None) -> Any:
    """A viser server that listens on exactly this address, prints nothing and opens no tunnel.

    Args:
        host: address to listen on; the default cannot be reached from other machines.
        port: 0: any free one.
        label: title of the controls.

    Returns:
        The ``viser.ViserServer``; `stop_server` ends it.

    Raises:
        MissingExtraError: viser is not installed.
        ConfigError: the address cannot be had.
    """
    viser = need("viser", extra="viz", what="pages")
    try:  # viser itself would go on to the next port without a word
        socket.create_server((host, port)).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"cannot listen on {host}, port {port}: {getattr(error, 'strerror', None) or error}; "
            "another --port (0: any free one) or --host may help"
        ) from error
    with _quiet():
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    server.request_share_url = lambda verbose=True: None  # nothing leaves this machine
    server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large")
    return server


def stop_server(server: Any) -> None:
    """Close the page's connections and the port."""
    with _quiet():
        server.stop()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Viser greets on stdout, which belongs to the command."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


__all__ = ["start_server", "stop_server"]
