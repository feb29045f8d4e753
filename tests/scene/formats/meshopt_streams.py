"""Streams that meshoptimizer 1.3.0 (npm) encoded, and what went into them, made here again.

Integers only, so that what went in is the same everywhere.
"""

import base64

import numpy as np


def scrambled(count: int) -> np.ndarray:
    """(count,) uint32 without pattern: the linear congruence of Numerical Recipes."""
    out, state = [], 1
    for _ in range(count):
        state = (1664525 * state + 1013904223) % 2**32
        out.append(state >> 8)
    return np.array(out, dtype=np.uint32)


def mixed_attributes() -> np.ndarray:
    """(300, 16) bytes: slow and fast shorts, a constant, noise in some bits, floats that double."""
    i = np.arange(300)
    shorts = np.stack([i * 3, 2000 - i * i // 7, 400 * (i % 9), 7 + 0 * i], axis=1).astype("<i2")
    noise = (scrambled(300) % 5 * 0x01000100 + scrambled(300) % 256).astype("<u4")[:, None]
    floats = (1.5 * 2.0 ** (i % 12)).astype("<f4")[:, None]
    return np.concatenate([part.view(np.uint8) for part in (shorts, noise, floats)], axis=1)


def grid_triangles() -> np.ndarray:
    """Indices of two triangles per cell of a grid, row by row; then some without order, and the first again."""
    corner = (np.arange(5)[:, None] * 7 + np.arange(6)).ravel()
    cells = np.stack([corner, corner + 7, corner + 8, corner, corner + 8, corner + 1], axis=1)
    return np.concatenate([cells.ravel(), scrambled(30) % 42, cells[0]]).astype(np.uint32)


def strip_indices() -> np.ndarray:
    """Two rising sequences in turn, and some without order."""
    i = np.arange(20)
    return np.concatenate([np.stack([i, 1000 + 2 * i], axis=1).ravel(), scrambled(12)]).astype(np.uint32)


ATTRIBUTES_0 = base64.b64decode(
    "oKqqqqoGZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZm"
    "ZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZgAEEAAACAAAAAACAPr///8AAREzM1VXd3mZu7vd3///Dw8P"
    "DxERERMTExMVFRUXFxcXGRkZGxsbGx0dHR8fHx8hISEjIyMjJSUlJycnJykpKSsrKystLS0vLy8vMTExMzMzMzU1NTc3Nzc5OTk7Ozs7PT09Pz8/"
    "P0FBQUNDQ0NFRUVHR0dHSUlJS0tLS01NTU9PT09RUVFTU1NTVVVVV1dXV1lZWVtbW1tdXV1fX19fYWFhY2NjY2VlZWdnZ2dpaWlra2trbW1tb29v"
    "b3FxcXNzc3N1dXV3d3d3eXl5e3t7e319fX9/f3+BgYGDg4ODhYWFh4eHh4mJiYuLi4uNjY2Pj4+PkVBVVVUAAQAAAAAEAAAAQAABAAAQAAEAAQAB"
    "AAQAEABABABABAEAEAQBAEAQBAQBAQEAQEBAQEEBAQEEBP////8A39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//"
    "39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f"
    "39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f"
    "39//39/f39/f39//39/f39/f39//39/f39/f39//39/f39/f39//39/fqqqqqgJCQkJPJCQkFyTyQkJCTyQkFxckJPJCQkJPJBcXJCQk8kJCQk8X"
    "FyQkJCTyQkJCF08kJCQk8kJCFxdCTyQkJCTyQhcXQkJPJCQkJPIXF0JCQk8kJCQkF/JCQkJPJCQkFxck8kJCQk8kJBcXJCTyQkJCTyQXFyQkJPJC"
    "QkJPFxckJCQk8kJCQhdPJCQkJPJCQhcXQk8kJCQk8kIXFwAAAAAAAAAA/////wBY+HJmqDj78YsfxvNhsW3ACB2xim/6J8rrBe8diUDWLmnT9xJW"
    "HHUVlHI8FtFt+Pz30ln2/mEeZguzRlPGvQHXWNzdxXmBa0LLhs2iPq0ftne5g+ARPxl9Uh7++Gk7pFuWELgZNGLlHq0YVazOlkYNecXSTFyb0xwy"
    "css7GzfKYVbCLxBkxiCF8NNfONynMKz7rFXHSoYLOG9G7AxLtXLla/ZmQxKoqFQQP+m7amNp5gRfAF1F1TorbmckJ/1OZxZSqnzovwyusK4tDjGF"
    "n3yighQnc6qzAuzObNrbL9I+kJIjFG0N7DaKzpmEJQii5CGABs/45+61d6zA7xEg1GiqmqqqBhI2cAYSEWAVYnZQAEEQAIdlACRQBEATFlgSNAcg"
    "GBIFEiAyZ2AQNiUAQgAAckARQxB0CQYGAgBUMjYjIQNDYjIDGHg0FQgyESEEASAnIYBwZSAGMAEYNHJjIFgAARQBAQR2JUUIAABUEhEiE4MEMEMl"
    "JFRAUgIlIDh4AHBgAAAAAKqaqqoGEjZwBhIRYBVidlAAQRAAh2UAJFAEQBMWWBI0ByAYEgUSIDJnYBA2JQBCAAByQBFDEHQJBgYCAFQyNiMhA0Ni"
    "MgMYeDQVCDIRIQQBICchgHBlIAYwARg0cmMgWAABFAEBBHYlRQgAAFQSESITgwQwQyUkVEBSAiUgOHgAcGAAAAAAAAAAAP////8A////////////"
    "////////////////////////////////////////////////////////////////////////////////////////////////////////////////"
    "////////////////////////////////////////////////////////////////////////////////////////////////////////////////"
    "////////////////////////////////////////////////////////////////////////////////////////////////////////VVVVVSIi"
    "IuILIiLiIgsi4iIiC+IiIuILCyIi4iILIuIiIgviIiLiCwsiIuIiCyLiIiIL4iIi4gsLIiLiIgsi4iIiC+IiIuILCyIi4iILIuIiIgviIiLiCwsq"
    "ZmZmZmZmZmZmZmZmZmZmZmZmZmZmZgAAAYAAAAA/kZGTk5OTlZWVl5eXl5mZmZubm5udnZ2fn5+foaGho6Ojo6Wlpaenp6epqakAAAAAFRAQQEEE"
    "EBBBBBBBAD/f39/f3//f39/f39/f3//f39/f39/f3//f39/f39/f3//f39/f39/f3//f3wAAAAAqQkJPJCQkJPIXF0JCQk8kJCQkF/JCQkJPJAAA"
    "FxcAAD+KUJDVQSCvwxlseH6bFpnKmACFBh33EhBdDJLIOhFYDgZxxD+VMcs9wnP1CwAAAAAqVhQzCDQFICMhBCdjIhAQJAdDQUUIEgAAACpWFDMI"
    "NAUgIyEEJ2MiEBAkB0NBRQgSAAAAAD///////////////////////////////////////////////////////////wAAAAAVIiLiIgsi4iIiC+Ii"
    "IgALAAAAAAAAAAAAAAAAAAAAAAAA0AcAAAcAWQAAAAAAwD8="
)

ATTRIBUTES_1 = base64.b64decode(
    "oZmuZ1qqqqqqBmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZm"
    "ZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmb6////AAERMzNVV3d5mbu73d///w8PDw8RERETExMT"
    "FRUVFxcXFxkZGRsbGxsdHR0fHx8fISEhIyMjIyUlJScnJycpKSkrKysrLS0tLy8vLzExMTMzMzM1NTU3Nzc3OTk5Ozs7Oz09PT8/Pz9BQUFDQ0ND"
    "RUVFR0dHR0lJSUtLS0tNTU1PT09PUVFRU1NTU1VVVVdXV1dZWVlbW1tbXV1dX19fX2FhYWNjY2NlZWVnZ2dnaWlpa2tra21tbW9vb29xcXFzc3Nz"
    "dXV1d3d3d3l5eXt7e3t9fX1/f39/gYGBg4ODg4WFhYeHh4eJiYmLi4uLjY2Nj4+Pj5EAGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5Lxnr"
    "OWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfI"
    "GSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5"
    "LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5AFj4cmaoOPvxix/G82GxbcAIHbGKb/onyusF7x2J"
    "QNYuadP3ElYcdRWUcjwW0W34/PfSWfb+YR5mC7NGU8a9AddY3N3FeYFrQsuGzaI+rR+2d7mD4BE/GX1SHv74aTukW5YQuBk0YuUerRhVrM6WRg15"
    "xdJMXJvTHDJyyzsbN8phVsIvEGTGIIXw01843KcwrPusVcdKhgs4b0bsDEu1cuVr9mZDEqioVBA/6btqY2nmBF8AXUXVOituZyQn/U5nFlKqfOi/"
    "DK6wri0OMYWffKKCFCdzqrMC7M5s2tsv0j6QkiMUbQ3sNorOmYQlCKLkIYAGz/jn7rV3rMDvESDUaKqaqqoGEjZwBhIRYBVidlAAQRAAh2UAJFAE"
    "QBMWWBI0ByAYEgUSIDJnYBA2JQBCAAByQBFDEHQJBgYCAFQyNiMhA0NiMgMYeDQVCDIRIQQBICchgHBlIAYwARg0cmMgWAABFAEBBHYlRQgAAFQS"
    "ESITgwQwQyUkVEBSAiUgOHgAcGCqmqqqBhI2cAYSEWAVYnZQAEEQAIdlACRQBEATFlgSNAcgGBIFEiAyZ2AQNiUAQgAAckARQxB0CQYGAgBUMjYj"
    "IQNDYjIDGHg0FQgyESEEASAnIYBwZSAGMAEYNHJjIFgAARQBAQR2JUUIAABUEhEiE4MEMEMlJFRAUgIlIDh4AHBgAAAAAAAQ/wAB/xAA/wEQ//8A"
    "Af8QAP8BEP//AAH/EAD/ARD//wAB/xAA/wEQ//8AAf8QAP8BEP//VVVVVRVVVdUKVVXVVQpV1VVVCtVVVdUKClVV1VUKVdVVVQrVVVXVCgpVVdVV"
    "ClXVVVUK1VVV1QoKVVXVVQpV1VVVCtVVVdUKClVV1VUKVdVVVQrVVVXVCgq5rmdaKmZmZmZmZmZmZmZmZmZmZmZmZmZmZmYAAJGRk5OTk5WVlZeX"
    "l5eZmZmbm5ubnZ2dn5+fn6GhoaOjo6OlpaWnp6enqampLxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSt5LxnrOWfIGSuKUJDVQSCv"
    "wxlseH6bFpnKmACFBh33EhBdDJLIOhFYDgZxxD+VMcs9wnP1CypWFDMINAUgIyEEJ2MiEBAkB0NBRQgSAAAqVhQzCDQFICMhBCdjIhAQJAdDQUUI"
    "EgAAAAAB/xAA/wEA/xVVVdVVClXVVVUK1VVVAAoAAAAAAADQBwAABwBZAAAAAADAPwFCAAE="
)

TRIANGLES = base64.b64decode(
    "4f4AHgAeAB4AHgAeAP4AHgAeAB4AHgAeAP4AHgAeAB4AHgAeAP4AHgAeAB4AHgAeAP4AHgAeAB4AHgAeAP/////+/v///v//D/8OAv8CAv8CAv8C"
    "Av8CAm8DN/w2Sf9IDx35GAP/BhH9C4Qq8hARrw3/IR4B8ysOCwB2h1ZneKmGZYlomAFpAAA="
)

SEQUENCE = base64.b64decode(
    "0QChHwQJBAkECQQJBAkECQQJBAkECQQJBAkECQQJBAkECQQJBAkECQQJmMLIB92j6Aug7cgI1dXeCs6swg7j090KwLOWF/nM/AXa76EYhZrUAqil"
    "vgezpfgGAAAAAA=="
)
