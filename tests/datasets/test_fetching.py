"""Fetch from a server on this machine that lists its files as the repositories do."""

from __future__ import annotations

import hashlib
import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from cellwise.cli import main
from cellwise.datasets import fetch_dataset
from cellwise.datasets.fetching import read_listing
from cellwise.errors import InputError

FILES = {"25degC/C20.csv": b"time_s,current_A\n" * 9000, "readme.txt": b"please cite\n"}


class Server:
    """What it serves, and how often each was asked for."""

    def __init__(self):
        self.pages = {}
        self.asked = []
        self.cut = set()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                outer.asked.append(self.path)
                body = outer.pages.get(self.path)
                if body is None:
                    self.send_error(404)
                    return
                self.send_response(200)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body[: len(body) // 2] if self.path in outer.cut else body)

            def log_message(self, *arguments):
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_port}"
        threading.Thread(target=self.http.serve_forever, daemon=True).start()


@pytest.fixture
def server():
    """The files, and lists of them as Mendeley Data, Zenodo and `sha256sum` write them."""
    made = Server()
    made.pages |= {f"/file/{name}": body for name, body in FILES.items()}
    url, sums = f"{made.url}/file/", {n: hashlib.sha256(b).hexdigest() for n, b in FILES.items()}
    mendeley = [
        {"filename": n, "content_details": {"sha256_hash": sums[n], "download_url": url + n}}
        for n in FILES
    ]
    zenodo = [
        {"key": n, "checksum": "md5:" + hashlib.md5(b).hexdigest(), "links": {"self": url + n}}
        for n, b in FILES.items()
    ]
    made.pages["/mendeley"] = json.dumps(mendeley).encode()
    made.pages["/zenodo"] = json.dumps({"files": zenodo}).encode()
    lines = (f"{checksum}  {name}\n" for name, checksum in sums.items())
    made.pages["/file/SHA256SUMS"] = "".join(lines).encode()
    yield made
    made.http.shutdown()
    made.http.server_close()


@pytest.mark.parametrize("listing", ["/mendeley", "/zenodo", "/file/SHA256SUMS"])
def test_every_file_comes_whole_and_once(server, tmp_path, listing):
    out = tmp_path / "data"
    for _ in range(2):
        files = fetch_dataset("panasonic_18650pf", out, server.url + listing)
        assert {f.relative_to(out).as_posix(): f.read_bytes() for f in files} == FILES
    assert server.asked.count("/file/25degC/C20.csv") == 1


def test_a_damaged_copy_is_fetched_again(server, tmp_path):
    out = tmp_path / "data"
    fetch_dataset("lg_18650hg2", out, server.url + "/mendeley")
    (out / "readme.txt").write_bytes(b"damaged")
    fetch_dataset("lg_18650hg2", out, server.url + "/mendeley")
    assert (out / "readme.txt").read_bytes() == FILES["readme.txt"]


def test_a_wrong_checksum_is_refused_and_nothing_kept(server, tmp_path):
    server.pages["/file/25degC/C20.csv"] += b"one more line\n"
    with pytest.raises(InputError, match="was not kept"):
        fetch_dataset("lg_18650hg2", tmp_path / "data", server.url + "/mendeley")
    assert [p for p in (tmp_path / "data").rglob("*") if p.is_file()] == []


def test_a_connection_that_breaks_is_refused_and_goes_on_later(server, tmp_path):
    server.cut = {"/file/25degC/C20.csv"}
    with pytest.raises(InputError):
        fetch_dataset("lg_18650hg2", tmp_path / "data", server.url + "/zenodo")
    server.cut = set()
    assert len(fetch_dataset("lg_18650hg2", tmp_path / "data", server.url + "/zenodo")) == 2


@pytest.mark.parametrize("page", [b"<html>not a list</html>", b"{}", b"[]", b'[{"filename": "a"}]'])
def test_a_page_that_is_no_list_is_refused(server, tmp_path, page):
    server.pages["/odd"] = page
    with pytest.raises(InputError):
        fetch_dataset("lg_18650hg2", tmp_path / "data", server.url + "/odd")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("name", ["../escape", "/etc/passwd", "a/../../b", "..\\x"])
def test_a_name_that_leaves_the_folder_is_refused(name):
    with pytest.raises(InputError):
        read_listing(f"{'a' * 64}  {name}\n", "https://example.org/sums")


def test_no_answer_no_entry_no_list(tmp_path, capsys):
    with pytest.raises(InputError, match="no answer"):
        fetch_dataset("lg_18650hg2", tmp_path / "d", "http://127.0.0.1:9/x")
    with pytest.raises(InputError, match="one of"):
        fetch_dataset("unobtainium", tmp_path / "d")
    with pytest.raises(InputError, match="data import"):
        fetch_dataset("calce_a123", tmp_path / "d")
    with pytest.raises(InputError, match="https"):
        fetch_dataset("calce_a123", tmp_path / "d", "file:///etc/passwd")
    assert not (tmp_path / "d").exists()
    assert main(["data", "fetch", "calce_a123", "-o", str(tmp_path / "d")]) == 2


def test_the_command_tells_what_it_has(server, tmp_path, capsys):
    code = main(
        ["data", "fetch", "lg_18650hg2", "-o", str(tmp_path / "d"), "--listing",
         server.url + "/mendeley", "--json"]
    )  # fmt: skip
    assert code == 0
    assert len(json.loads(capsys.readouterr().out)["files"]) == 2
