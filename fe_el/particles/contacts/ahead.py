"""Sub-steps, which can be compiled before there are any contacts: what they are given has the same types in every scene."""
import numpy as np
from numba import from_dtype, types

from fe_el.compiled.ahead import Ahead
from fe_el.particles.contacts import sub_steps as _sub_steps
from fe_el.particles.contacts.blocks import Block
from fe_el.particles.contacts.contact_laws import LawNumbers
from fe_el.particles.contacts.records import (
    Assembly,
    Candidates,
    Drift,
    FacetRows,
    Facets,
    FacetScratch,
    Near,
    Pairs,
    Rows,
    ShapeRows,
    Tiles,
    WallRows,
)
from fe_el.particles.ghosts import GhostRows

WHOLE, REAL, FLAG = types.int64, types.float64, types.boolean


def _arrays(text):
    """Types of arrays from letters of numpy's dtypes and dimensions: ``f82 u41`` are (n, m) of float64 and (n,) of
    uint32."""
    return [types.Array(from_dtype(np.dtype(word[:-1])), int(word[-1]), "C") for word in text.split()]


def _record(kind, *items):
    return types.NamedTuple(items, kind)


def kinds():
    """Types of the arguments of :func:`fe_el.particles.contacts.sub_steps.sub_steps`."""
    listed = _arrays("u41 u41 f82 i41")  # particle and partner, springs, stamps
    facets = _record(Facets, *_arrays("f83 u42 u41 f82 i82"))
    scratch = _record(FacetScratch, *_arrays("f82 f82 u81 ?1 f82 i81"))
    block = _record(Block, *_arrays("f81 u81 u81 u81"))
    law = _record(LawNumbers, WHOLE, WHOLE, FLAG, FLAG, *_arrays("f83"))
    assembly = _record(Assembly, _record(Rows, *_arrays("f82 f82 f82 f81 f81 u41 f82")),
                       _record(Drift, *_arrays("f82 f81 f82 f82")), _record(Pairs, *listed),
                       _record(Candidates, *_arrays("f81 f81 u41 u41")), _record(FacetRows, *listed, facets, scratch),
                       _record(ShapeRows, *listed, *_arrays("i81 f82")),
                       _record(WallRows, *_arrays("f82 i81 f82 f81 f82 i81 f83")), block, block, law, law)
    ghosts = _record(GhostRows, *_arrays("i81 f82 f82 i81 f82 f82"), types.Tuple((*_arrays("u11 u11"), WHOLE)),
                     types.Tuple((WHOLE, types.UniTuple(WHOLE, 4), *_arrays("f81"))))
    tiles = _record(Tiles, *_arrays("i81 i81 i81 i81 i81 i81 f82"), *(WHOLE,) * 6)
    return [WHOLE, REAL, WHOLE, types.UniTuple(REAL, 2), assembly, ghosts, tiles, _record(Near, REAL, WHOLE, WHOLE), WHOLE,
            REAL]


sub_steps = Ahead(__name__, "sub_steps", _sub_steps.sub_steps, kinds)
