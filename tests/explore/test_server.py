"""The server answers this machine under its own name, and nobody else."""

from __future__ import annotations

import http.client
import socket

import pytest

from bayes_aero.errors import InputError
from bayes_aero.explore.server import PageServer

UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",  # of RFC 6455
    "Sec-WebSocket-Protocol": "bokeh, none",
}


def asked(port, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers={name.replace("_", "-"): x for name, x in headers.items()})
    answer = connection.getresponse()
    found = answer.status, answer.read().decode("utf-8", "replace") if answer.status != 101 else ""
    connection.close()
    return found


def test_other_hosts_are_refused_and_the_page_names_none(served):
    own = f"127.0.0.1:{served.port}"
    status, html = asked(served.port, Host=own)
    assert status == 200
    assert asked(served.port, Host=f"localhost:{served.port}")[0] == 200
    for host in ("example.com", f"example.com:{served.port}", "127.0.0.1", f"{own}.example.com", "127.0.0.1:1"):
        for path in ("/", "/ws", "/static/js/bokeh.min.js", "/metadata"):
            assert asked(served.port, path, Host=host)[0] == 403, host
    assert "http://" not in html.replace(f"http://{own}", "")
    assert "https://" not in html
    assert "cdn." not in html


@pytest.mark.parametrize(
    "origin", ["http://example.com", "http://127.0.0.1:1", "null", "https://127.0.0.1.example.com"]
)
def test_a_websocket_of_another_origin_is_refused(served, origin, monkeypatch):
    monkeypatch.setenv("BOKEH_ALLOW_WS_ORIGIN", "example.com,127.0.0.1:1")
    assert asked(served.port, "/ws", Origin=origin, **UPGRADE)[0] == 403


def test_it_listens_on_this_machine_alone(served):
    own = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    for address in own - {"127.0.0.1"}:
        with socket.socket() as other:
            other.settimeout(5.0)
            assert other.connect_ex((address, served.port)) != 0


def test_a_port_that_is_taken_is_one_sentence(served):
    with pytest.raises(InputError, match=rf"port {served.port} cannot be used \(it is taken\); give another --port"):
        PageServer(lambda _: None, served.port)
