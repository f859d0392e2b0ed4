"""The web server of the page, which viser runs."""

import contextlib
import io
import socket

import viser

from gelgap.assets.names import quoted


def start_server(host: str, port: int) -> viser.ViserServer:
    """Start viser's server; port 0 takes any free one.

    Raises
    ------
    ValueError
        If the port is taken or the address is none of this machine: viser itself would silently take another port.
    """
    _check_free(host, port)
    # viser prints a table of addresses, and this program prints its own.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="gelgap", verbose=False)
    if port and server.get_port() != port:
        server.stop()
        raise ValueError(_taken(port))
    return server


def _check_free(host: str, port: int) -> None:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        raise ValueError(f"--host = {quoted(host)}: is no address of this machine ({error})") from None
    with socket.socket(family, kind, protocol) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except PermissionError:
            raise ValueError(f"--port = {port}: is not allowed; choose one from 1024 on") from None
        except OSError as error:
            if error.errno in (98, 48):
                raise ValueError(_taken(port)) from None
            raise ValueError(
                f"--host = {quoted(host)}: is no address of this machine ({error.strerror})"
            ) from None


def _taken(port: int) -> str:
    return (
        f"--port = {port}: is taken by another program; choose another, for example --port {port % 65535 + 1}"
    )
