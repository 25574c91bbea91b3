"""The service under load, over TLS: requests from eight clients at once, then broken ones; errors, rate, memory.

    python validation/gallery/serve.py [--requests 1000] [--broken 10000]

writes ``tables/serve.json`` beside this file. `splitknit serve` runs as a process of its own, so that its memory is not
the clients'. Two simulated prints are enrolled; each request verifies a template. A tenth of the broken requests come
before memory is first read, as each thread keeps some.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import datetime
import ipaddress
import json
import os
import random
import resource
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from splitknit import encode_print_png
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

HERE = Path(__file__).resolve().parent
TOKEN = "a-token-of-many-letters"


def press(seed: int) -> str:
    master = master_print("left_loop", seed, MasterPrintSettings(half_width_mm=7.0, distal_mm=16.0, proximal_mm=1.0))
    image = np.pad(ink_print(master), 20, constant_values=255)
    return base64.b64encode(encode_print_png(image, 500.0)).decode()


def certificate(folder: Path) -> tuple[Path, Path]:
    """A certificate of this machine for a day, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "127.0.0.1")])
    now = datetime.datetime.now(datetime.UTC)
    names = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    made = made.serial_number(1).not_valid_before(now).not_valid_after(now + datetime.timedelta(days=1))
    chain, private = folder / "certificate.pem", folder / "key.pem"
    signed = made.add_extension(names, critical=False).sign(key, hashes.SHA256())
    chain.write_bytes(signed.public_bytes(serialization.Encoding.PEM))
    form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    private.write_bytes(key.private_bytes(*form))
    return chain, private


def memory_mb(process: int) -> float:
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return round(pages * resource.getpagesize() / 1e6, 1)


def cpu_s(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def load(requests: int, broken: int) -> dict[str, Any]:
    """Start the service, send requests, and return what came of them."""
    with tempfile.TemporaryDirectory() as scratch:
        chain, private = certificate(Path(scratch))
        with socket.socket() as place:
            place.bind(("127.0.0.1", 0))
            port = place.getsockname()[1]
        command = [
            sys.executable, "-m", "splitknit", "serve", "--gallery", f"{scratch}/g.skg", "--port", str(port),
            "--certificate", str(chain), "--certificate-key", str(private), "--audit", f"{scratch}/audit",
        ]  # fmt: skip
        process = subprocess.Popen(
            command, env={**os.environ, "SPLITKNIT_SERVE_TOKEN": TOKEN}, stderr=subprocess.DEVNULL
        )
        trust = ssl.create_default_context(cafile=str(chain))
        own, clients = threading.local(), contextlib.ExitStack()

        def sent(act: str, content: bytes) -> httpx.Response:
            if not hasattr(own, "client"):
                own.client = clients.enter_context(
                    httpx.Client(
                        base_url=f"https://127.0.0.1:{port}", headers={"Authorization": f"Bearer {TOKEN}"},
                        timeout=600, verify=trust,
                    )
                )  # fmt: skip
            answer: httpx.Response = own.client.post(act, content=content)
            return answer

        def asked(act: str, **fields: str) -> dict[str, Any]:
            return dict(sent(act, json.dumps(fields).encode()).json())

        try:
            for _ in range(600):
                try:
                    sent("/verify", b"")
                    break
                except httpx.ConnectError:
                    time.sleep(0.1)
            for name, seed in (("ann", 1), ("bob", 2)):
                asked("/enroll", person=name, finger="right_index", print=press(seed))
            good = json.dumps({"person": "ann", "template": asked("/quality", print=press(1))["template"]}).encode()
            found: dict[str, Any] = {"cores": os.cpu_count(), "memory_mb_before": memory_mb(process.pid)}
            started, busy = time.perf_counter(), cpu_s(process.pid)
            with ThreadPoolExecutor(8) as pool:
                answers = list(pool.map(lambda _: sent("/verify", good).status_code, range(requests)))
            found |= {
                "requests": requests, "errors": sum(code != 200 for code in answers),
                "requests_a_second": round(requests / (time.perf_counter() - started), 1),
                "cpu_ms_a_request": round(1000 * (cpu_s(process.pid) - busy) / max(requests, 1), 2),
                "memory_mb_after_requests": memory_mb(process.pid),
            }  # fmt: skip

            def damaged(seed: int) -> int:
                one, data = random.Random(seed), bytearray(good)
                for _ in range(1 + seed % 9):
                    data[one.randrange(len(data))] = one.randrange(256)
                return sent("/verify", bytes(data[: one.randrange(len(data))])).status_code

            codes, memory = [], []
            with ThreadPoolExecutor(8) as pool:
                for tenth in range(10):
                    codes += pool.map(damaged, range(tenth * broken // 10, (tenth + 1) * broken // 10))
                    memory.append(memory_mb(process.pid))
            others = sorted(set(codes) - {400})
            return found | {
                "broken": broken, "refused": codes.count(400), "other_codes": others, "memory_mb_by_tenths": memory
            }  # fmt: skip
        finally:
            clients.close()
            process.terminate()
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--requests", type=int, default=1000)
    parser.add_argument("--broken", type=int, default=10_000)
    options = parser.parse_args()
    found = load(options.requests, options.broken)
    (HERE / "tables" / "serve.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
