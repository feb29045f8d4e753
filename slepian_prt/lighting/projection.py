"""Distant light of any kind projected on spherical harmonics as Mitsuba would light with it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.lighting.emitters import SkyEnvironment, project_emitter
from slepian_prt.lighting.environment import Environment, about_up, checked_environment
from slepian_prt.lighting.fitting import check_lighting, fit_lighting, is_lighting
from slepian_prt.lighting.light_text import is_light_text, read_light_text
from slepian_prt.lighting.map_files import Checked, array_rows, file_rows
from slepian_prt.lighting.texel_projection import TexelProjection
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.sphere.rotation import rotate_sh

log = logging.getLogger(__name__)


def project_environment(
    environment: Environment | str | Path | ArrayLike | Any,
    bandlimit: int,
    *,
    rotate: float | ArrayLike = 0.0,
    clamp_negative: bool = False,
) -> NDArray[np.float64]:
    """Spherical-harmonic coefficients of a map's radiance, in world space.

    e_lm = ∫ L(ω) y_lm(ω) dω with the y_lm of `real_sh`: index l² + l + m, orthonormal, Condon–Shortley phase; their
    polar axis is z, while maps have y up and +z in their middle column. As in Mitsuba, the first and last rows of a map
    stand on the poles, row r at r/(H-1); other tools have rows at centres, (r+½)/H, and get other light of the same
    texels: by 0.4 % at 256 rows, 1.5 % at 64 and 5 % at 16 up to degree 2 of the shipped sky. `convert_sh` gives the
    coefficients as other tools have them.

    Exact for maps that are bandlimited themselves; maps of fewer than 8 rows per degree are interpolated first, as
    Mitsuba would. Files (.exr) are read a few rows at a time.

    Parameters
    ----------
    environment : Environment, a path, an array (H, 2H, 3), or an environment emitter of Mitsuba's current variant
        A path that ends in .txt is lighting itself, as GAMES202's ``light.txt``: a line of red, green and blue for each
        harmonic.
    bandlimit : int
    rotate : float or (3, 3)
        Degrees, counter-clockwise about the up axis y; or any rotation of the light.
    clamp_negative : bool
        Of all but an `Environment`: set negative texels to zero however much light they are.

    Returns
    -------
    (3, (L+1)²) float64

    Raises
    ------
    UserError, ValueError
    """
    bandlimit = check_bandlimit(bandlimit)
    return project_checked(environment, bandlimit, rotate=rotate, clamp_negative=clamp_negative)[0]


@one_blas_thread()
def project_checked(
    environment: Environment | str | Path | ArrayLike | Any,
    bandlimit: int,
    *,
    rotate: float | ArrayLike = 0.0,
    clamp_negative: bool = False,
    fitted_to: str = "the projection",
) -> tuple[NDArray[np.float64], int]:
    """`project_environment`, and how many negative texels were set to zero.

    ``fitted_to`` is what harmonics of another bandlimit are cut or filled up for, in the remark about that.
    """
    turn = rotation_matrix(rotate)
    if hasattr(environment, "is_environment"):
        return _of_emitter(environment, bandlimit, turn, clamp_negative)
    if isinstance(environment, str | Path) and is_light_text(environment):
        if clamp_negative:
            log.warning("%s: holds harmonics, not texels; `clamp_negative` changes nothing in it", environment)
        return rotate_sh(fit_lighting(read_light_text(environment), bandlimit, fitted_to), turn), 0
    if isinstance(environment, str | Path):
        rows = file_rows(environment)
    elif isinstance(environment, SkyEnvironment):
        return environment.project(bandlimit, turn), environment.clamped
    elif isinstance(environment, Environment):
        height, width = environment.texels.shape[:2]
        projection = TexelProjection(height, width, bandlimit, turn @ environment.to_world)
        return projection(environment.texels), environment.clamped
    else:
        rows = array_rows(environment, "environment", "environment")
    if not TexelProjection.enough_rows(rows.height, bandlimit):
        return project_checked(checked_environment(rows, clamp_negative), bandlimit, rotate=turn)
    checked = Checked(rows, clamp_negative)
    lighting = TexelProjection(rows.height, rows.width, bandlimit, turn).of_rows(checked)
    return lighting, checked.clamped


@one_blas_thread()
def lighting_at(
    light: Environment | str | Path | ArrayLike | Any, bandlimit: int, *, clamp_negative: bool = False
) -> NDArray[np.float64]:
    """Coefficients at a bandlimit of any light: of what `project_environment` takes, or given as coefficients.

    Parameters
    ----------
    light : coefficients (3, n²) or (B, 3, n²), or as for `project_environment`
        An array is taken for coefficients if its last two axes say so. A map cannot have such a shape: its last axis
        has one or three entries, the coefficients of degree 0 have one, and three rows of a map are six wide.
    bandlimit : int
        Coefficients of another one are cut, or zero in the degrees that they have not, with a remark.
    clamp_negative : bool
        Of a path or an array of texels: see `project_environment`.

    Returns
    -------
    (3, (L+1)²) or (B, 3, (L+1)²) float64

    Raises
    ------
    UserError
        As `project_environment`, and what is neither.
    """
    bandlimit = check_bandlimit(bandlimit)
    if isinstance(light, str | Path | Environment) or hasattr(light, "is_environment"):
        return project_checked(light, bandlimit, clamp_negative=clamp_negative, fitted_to="the transfer")[0]
    if not isinstance(light, Sequence | np.ndarray | np.generic):
        raise UserError(f"light must be a path, an Environment, an array or an emitter, not {type(light).__name__}")
    values = real_numbers(light, "lighting")
    if is_lighting(values.shape):
        check_lighting(values)
        return np.asarray(fit_lighting(values, bandlimit))
    if values.ndim == 3 and values.shape[1] == 2 * values.shape[0] and values.shape[2] in (1, 3):
        return project_environment(light, bandlimit, clamp_negative=clamp_negative)
    raise UserError(
        f"lighting must have shape (3, n²), n² harmonics in red, green and blue, or that of a map, (H, 2H, 3), not "
        f"{values.shape}"
    )


def rotation_matrix(rotate: float | ArrayLike) -> NDArray[np.float64]:
    """The rotation matrix that ``rotate`` of `project_environment` stands for.

    Raises
    ------
    UserError
        Not finite, or a matrix that is no rotation.
    """
    if hasattr(rotate, "matrix"):  # a transform of Mitsuba
        rotate = np.array(rotate.matrix, dtype=np.float64).reshape(4, 4)[:3, :3]
    matrix = real_numbers(rotate, "rotation")
    if matrix.ndim == 0:
        return about_up(float(matrix))
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        raise UserError(f"rotation must be a number of degrees or a (3, 3) matrix, not of shape {matrix.shape}")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-6 or np.linalg.det(matrix) < 0.0:
        raise UserError("rotation must be a rotation matrix: orthogonal, with determinant 1")
    return matrix


def _of_emitter(
    emitter: Any, bandlimit: int, turn: NDArray[np.float64], clamp_negative: bool
) -> tuple[NDArray[np.float64], int]:
    if not emitter.is_environment():
        raise UserError(f"emitter {emitter.class_name()} is no distant light; give an envmap, a sunsky or a constant")
    import mitsuba as mi

    return project_emitter(mi, emitter, bandlimit, turn, "emitter", clamp_negative)
