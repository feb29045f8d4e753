"""Damaged files of every kind give what is right, or one line; ``scripts/fuzz`` goes on for as long as one likes."""

import pytest

from tests.fuzzing import known_faults
from tests.fuzzing.attempts import KINDS
from tests.fuzzing.run import prepare, run

COUNTS = {"prt": 500, "npz": 60, "meshes": 200, "maps": 100, "journals": 50, "scenes": 50}

# The same attempts on every machine.
FIRST = 22_000_000


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_in_one_line_or_read(kind, tmp_path):
    prepare(kind, tmp_path / "seeds")
    findings = run(kind, tmp_path / "seeds", FIRST, COUNTS[kind])
    assert not findings.faults, "\n".join(map(str, findings.faults))
    assert findings.counts.total() == COUNTS[kind]
    if kind == "journals":
        assert findings.counts["read"] == COUNTS[kind], "a damaged journal is no reason to refuse a job"
    else:
        assert min(findings.counts["read"], findings.counts["refused"]) >= COUNTS[kind] // 20, findings.counts


@pytest.mark.slow
def test_every_kind_of_fault_is_seen(tmp_path):
    """Attempts that crash, hang, print, warn, and raise what they must not: each is told, and others follow."""
    (tmp_path / "seeds").mkdir()
    known = {"module": known_faults.__name__, "patience": 10.0}
    findings = run("faults", tmp_path / "seeds", 0, len(known_faults.ATTEMPTS), **known)
    assert tuple(fault.outcome for fault in findings.faults) == known_faults.OUTCOMES
    assert [fault.seed for fault in findings.faults] == list(range(2, len(known_faults.ATTEMPTS)))
    assert findings.counts == {"read": 1, "refused": 1, "fault": len(known_faults.OUTCOMES)}
    assert "libpng warning" in str(findings.faults[4])
