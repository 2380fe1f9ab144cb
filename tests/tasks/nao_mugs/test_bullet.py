import pickle
import subprocess
import sys

import pytest

from bra.tasks.nao_mugs import bullet
from bra.tasks.nao_mugs.bullet import connect


def test_clients_do_not_share_a_simulation():
    first, second = connect(), connect()
    first.createMultiBody(0.0, first.createCollisionShape(first.GEOM_SPHERE))
    assert first.getNumBodies() == 1
    assert second.getNumBodies() == 0


def test_a_closed_client_is_gone_and_leaves_the_others():
    first, second = connect(), connect()
    first.close()
    first.close()
    with pytest.raises(second.error, match="Not connected"):
        first.getNumBodies()
    assert second.getNumBodies() == 0


def test_a_client_stays_in_its_process():
    with pytest.raises(TypeError, match="connect inside the process"):
        pickle.dumps(connect())


def test_missing_pybullet_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(ImportError, match=r"cannot be imported .*pip install pybullet") as error:
        connect()
    assert "\n" not in str(error.value)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no DISPLAY")
def test_window_without_display_is_refused(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match="leave --gui out, or set DISPLAY"):
        connect(gui=True)


def test_connecting_prints_nothing():
    module = f"runpy.run_path({bullet.__file__!r})"
    program = f"import runpy; client = {module}['connect'](); client.getNumBodies()"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert done.stdout == b""
    assert done.stderr == b""
