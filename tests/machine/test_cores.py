"""Cores that control groups grant."""

import math
import os

import pytest

from slepian_prt.machine.cores import allowed_cores, core_quota, describe_cores, usable_cores
from tests.machine.test_memory import write

V2 = {"proc__self__cgroup": "0::/a/b\n", "sys__fs__cgroup__cgroup.controllers": "cpu"}
V1 = {"proc__self__cgroup": "1:cpu,cpuacct:/a\n0::/\n"}


def version_2(inner: str, outer: str) -> dict[str, str]:
    return {**V2, "sys__fs__cgroup__a__b__cpu.max": inner, "sys__fs__cgroup__a__cpu.max": outer}


def version_1(quota: str, period: str = "100000") -> dict[str, str]:
    folder = "sys__fs__cgroup__cpu,cpuacct__a__cpu."
    return {**V1, f"{folder}cfs_quota_us": quota, f"{folder}cfs_period_us": period}


@pytest.mark.parametrize(
    ("files", "quota"),
    [
        (version_2("max 100000", "150000 100000"), 1.5),
        (version_2("50000 100000", "150000 100000"), 0.5),
        (version_2("max 100000", "max 100000"), None),
        (version_2("", "nonsense"), None),
        (version_1("250000"), 2.5),
        (version_1("-1"), None),
        (version_1("100000", "0"), None),
        ({}, None),
    ],
)
def test_the_smallest_quota_of_nested_groups_counts(tmp_path, files, quota):
    root = write(tmp_path, **files)
    assert core_quota(root) == quota
    expected = len(allowed_cores()) if quota is None else min(len(allowed_cores()), math.ceil(quota))
    assert usable_cores(root) == expected


def test_the_doctor_says_what_limits(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    assert describe_cores(tmp_path) == "64"
    assert describe_cores(write(tmp_path, **version_1("200000"))) == "2 of 64 (limit of the control group, 2)"
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3}, raising=False)
    assert describe_cores(tmp_path) == "1 of 64 (those that this process may run on)"
