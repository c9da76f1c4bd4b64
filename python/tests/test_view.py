"""The live view: its page, its arrays, and its end."""

from __future__ import annotations

import gc
import json
import socket
import time
import urllib.error
import urllib.request
from urllib.parse import urlsplit

import pytest

import pwrfgs


def get(address, path="", **headers):
    """Answer to a request."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return urllib.request.urlopen(urllib.request.Request(address + path, headers=named), timeout=20)


def header(answer):
    """Names and shapes of the arrays of an answer."""
    body = answer.read()
    return json.loads(body[8 : 8 + int.from_bytes(body[:8], "little")])


def is_listening(address):
    """Whether a server answers at the port of an address."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", urlsplit(address).port)) == 0


def test_view_of_a_run(run, capsys):
    view = run.view()
    assert view.address in capsys.readouterr().out and view.address in repr(view) and not view.closed
    page = get(view.address)
    assert b'<main data-source="server">' in page.read()
    assert "frame-ancestors http://localhost:*" in page.headers["Content-Security-Policy"]
    assert header(get(view.address, "predict?tx=0.5,0.2,1"))["picture"]["shape"] == [15, 60]
    assert header(get(view.address, "link?link=3"))["picture"]["shape"] == [15, 60]
    html = view._repr_html_()
    assert f'<iframe src="{view.address}"' in html
    view.close()
    view.close()
    assert view.closed and repr(view) == "<View closed>" and "iframe" not in view._repr_html_()
    assert not is_listening(view.address)
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", urlsplit(view.address).port))


def test_frames_and_other_origins(run):
    with run.view() as view:
        frame = {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Dest": "iframe"}
        assert get(view.address, **frame).status == 200
        for refused in [dict(frame, Sec_Fetch_Dest="empty"), {"Origin": "http://localhost:8888"}]:
            with pytest.raises(urllib.error.HTTPError, match="403"):
                get(view.address, **refused)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(view.address[:-10] + "/")
    assert view.closed and not is_listening(view.address)


def test_several_views_until_they_are_deleted(run, model, pipeline, dataset):
    trained = pwrfgs.Trainer(pipeline, dataset).model()  # without a file
    views = [run.view("NearestNeighbours(k: 2)"), model.view(pwrfgs.NearestNeighbours(k=2)), trained.view()]
    addresses = [view.address for view in views]
    assert len(set(addresses)) == 3
    for address in addresses:
        assert header(get(address, "predict?tx=0.5,0.2,1"))["picture"]["shape"] == [15, 60]
    for address in addresses[:2]:
        assert header(get(address, "predict?side=1&tx=0.5,0.2,1"))["picture"]["shape"] == [15, 60]
    del views
    gc.collect()
    ends = time.monotonic() + 5
    while any(map(is_listening, addresses)) and time.monotonic() < ends:
        time.sleep(0.05)
    assert not any(map(is_listening, addresses))


def test_views_of_nothing(run, model, tmp_path):
    for call, problem in [
        (lambda: run.view("Kirging"), "neither a file, a folder nor a baseline"),
        (lambda: run.view(tmp_path), "run"),
        (lambda: run.view(model), "beside is a Model; give the path of its file or run folder"),
        (lambda: model.view(3), "3: neither"),
    ]:
        with pytest.raises(pwrfgs.InputError) as error:
            call()
        assert problem in str(error.value)
