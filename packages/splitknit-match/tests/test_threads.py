"""One thread of BLAS in every thread of a process, from the first comparison on."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from splitknit_match.threads import one_blas_thread
from threadpoolctl import ThreadpoolController

def work(_):
    one_blas_thread()
    libraries = ThreadpoolController().select(user_api="blas").info()
    return {library["num_threads"] for library in libraries}

FIRST
with ThreadPoolExecutor(4) as pool:
    print(set().union(*pool.map(work, range(8)), work(None)))
"""


@pytest.mark.parametrize("first", ["work(None)", "pass"], ids=["main thread first", "any first"])
def test_the_limit_holds_in_every_thread(first):
    pytest.importorskip("threadpoolctl")
    environment = {name: each for name, each in os.environ.items() if "NUM_THREADS" not in name}
    command = [sys.executable, "-c", PROGRAM.replace("FIRST", first)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "{1}\n"
