"""Compressed precomputed radiance transfer on spherical Slepian functions, built on Mitsuba 3.

    import slepian_prt as sp
    transfer = sp.precompute(sp.example("knot"), samples=64)             # trace: (V, channels, M) transfer vectors
    packed = sp.compress(transfer, tolerance=0.05)                       # what a .prt file holds
    lighting = sp.project_environment(sp.example("sky"), bandlimit=10)   # (3, M) spherical harmonics of a map
    radiance = sp.relight(packed, lighting)                              # (V, 3)

Transfer and relighting
    precompute                      Trace what light reaches each vertex of a mesh or scene: its transfer vectors.
    precompute_compressed           The same, compressed as it is traced; here or by Dask's workers.
    precompute_set, ScanResult      The same of many files into one folder, compressed; also as PIFu and ICON read it.
    capture                         Trace what light reaches each pixel of a camera: one render, relit under any light.
    Transfer                        Transfer vectors and the mesh that they belong to; save.
    load_transfer                   Read transfer that was saved uncompressed.
    compress                        Project transfer vectors on few functions per cap and code the coefficients.
    compress_film                   The same for captured pixels, to an error below their noise.
    CompressedTransfer              What a .prt file holds; save, reconstruct, predicted errors.
    load                            Read a .prt file.
    relight                         Radiance at the vertices under given lighting.
    gpu_transfer, GpuTransfer       The same for graphics hardware: 16 bytes per vertex, and what a shader does with it.
    export_model, Exported          A .glb for engines: transfer for a shader, or ambient occlusion and the like.
    render_picture, save_picture    Draw a model under a light, as an array or a file.
    save_page                       Write a page for any browser: the model, its transfer and lights to turn.
    register                        Make the integrators `slepian_prt` and `slepian_prt_capture` known to Mitsuba.
Meshes and light
    read_mesh, make_mesh            A mesh from a file, or from arrays.
    Mesh                            Triangles with a normal and an albedo at each vertex.
    read_environment                An environment map from a file, an array or a Mitsuba emitter.
    project_environment             A map's spherical harmonic coefficients, in one step.
    Environment                     An environment map; turn it, project it.
    falling_prior                   Light prior 1/(l+1): skies without a sun.
    measured_prior                  Light prior from the mean spectrum of some maps.
    example                         Path of a scene or map that is shipped with the package.
Functions on the sphere
    real_sh                         Evaluate all real spherical harmonics up to a bandlimit.
    rotate_sh                       Rotate spherical harmonic expansions.
    hemispherical_sh, h_basis       What others use over the hemisphere: HSH (Gautron et al.), H-basis (Habel & Wimmer).
    convert_sh                      Coefficients of PIFu, three.js, Filament, SHTOOLS and others as ours, and back.
    cap_basis, CapBasis             Slepian functions of a spherical cap, or of transport over it.
    region_basis, RegionBasis       Slepian functions of a region of any shape.
    cap_region                      The region inside a cap.
    polygon_region                  The region inside a spherical polygon.
    mask_region                     The region where a map is not zero.
    region_area, region_boundary    Area of a region, and length of its boundary.
    minimal_enclosing_cap           The smallest cap that holds some directions.
    cosine_lobe                     Zonal coefficients of the clamped cosine and its powers.
    zonal_coefficients              Zonal coefficients of any lobe.
    measured_moment, SecondMoment   Second moment of transfer vectors in their own frames.
Counting functions
    effective_dimension             How many functions light transport takes around each vertex of a model.
    EffectiveDimension              The result: for each vertex, with quantiles by area.
    shannon_number                  N, the sum of all concentrations.
    generalized_shannon_number      N_g of Lessig & Fiume (2010).
    refined_shannon_number          N_ref, two-term asymptotics.
    szego_number                    By Szegő's theorem, after Mahajan et al. (2007): no second term.
    concentration_count             How many concentrations are above a threshold, exactly.
    line_concentrations             Concentrations of functions on the line, in an interval.
    line_number                     Slepian's estimate of how many of them are above a threshold.
    disc_concentrations             Concentrations on a disc of the plane, the limit of small caps.
    DiscSpectrum                    The result, with the order of each.
Plots
    plot_picture                    A relit model, on Matplotlib axes.
    plot_errors                     Errors that `slepian-prt compare` measured, against bytes or functions.
    plot_spectrum                   Eigenvalues of a basis.
Errors
    UserError                       A mistake in the input: one line that says what is wrong and what to do.

Names are loaded when they are first used, so the mathematics of the sphere works where Mitsuba cannot run. The
command line is `slepian-prt`; its manual and the conventions (axes, units, signs) are in the folder docs.
"""

import lazy_loader as _lazy

# The names and their homes stand in __init__.pyi, which type checkers read too.
_attribute, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version  # only when it is asked for: half of what the package takes to import

        return version(__name__)
    return _attribute(name)
