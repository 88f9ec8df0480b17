"""Headers that C and shaders share, compiled as GLSL; in Blenders with graphics (5.2 and later)."""

from pathlib import Path

import gpu
import numpy as np
import pytest
from gpu_extras.batch import batch_for_shader

from addon.core import sh_basis
from gscore.raster import header
from tests.addon.live import graphics

pytestmark = pytest.mark.graphics

SHARED = Path(__file__).parents[3] / "csrc" / "shared"
VERTEX = "void main() { gl_Position = vec4(corner, 0.0, 1.0); }"
FRAGMENT = """
void main()
{
  const float second[5] = float[5](GS_SH_C2);
  const float third[7] = float[7](GS_SH_C3), fourth[9] = float[9](GS_SH_C4);
  const float taps[6] = float[6](GS_SSIM_TAPS);
  const float power[6] = float[6](GS_EXP2_5);
  float sum = 0.0;
  for (int k = 0; k < 6; k++) {
    sum = sum * 0.25 + power[k];
  }
  result = vec4(second[2], third[3] + fourth[4], sum, GS_EPS2D - GS_LOG2_ALPHA_MIN * GS_ALPHA_MIN);
}
"""


VIEW = """
void main()
{
  float matrix = view.viewmat[1][2] + view.fy + float(view.height) + view.near_plane;
  result = vec4(matrix, view.eps2d, float(view.sh_degree), view.background.z + float(view.outputs));
}
"""


def pixel(header: str, fragment: str, view: bytes = b"") -> np.ndarray:
    """[4] float32: the result of a shader that includes a header, and reads a gs_view."""
    info = gpu.types.GPUShaderCreateInfo()
    info.typedef_source(header)
    if view:
        info.uniform_buf(0, "gs_view", "view")
    info.vertex_in(0, "VEC2", "corner")
    info.fragment_out(0, "VEC4", "result")
    info.vertex_source(VERTEX)
    info.fragment_source(fragment)
    shader = gpu.shader.create_from_info(info)
    if view:
        words = np.frombuffer(view, np.float32).tolist()
        block = gpu.types.GPUUniformBuf(gpu.types.Buffer("FLOAT", len(words), words))
        shader.uniform_block("view", block)  # `block` must live until the draw
    corners = {"corner": [(-1, -1), (3, -1), (-1, 3)]}
    target = gpu.types.GPUTexture((1, 1), format="RGBA32F")
    with gpu.types.GPUFrameBuffer(color_slots=target).bind():
        batch_for_shader(shader, "TRIS", corners).draw(shader)
    found = target.read()
    found.dimensions = 4
    return np.array(found, np.float32)


def test_constants_are_glsl() -> None:
    """Oracle: Python's values of harmonics, powers and limits; errors of the compiler raise."""
    graphics.begin()
    found = pixel((SHARED / "constants.h").read_text(encoding="utf-8"), FRAGMENT)
    up = sh_basis(4, np.array([[0.0, 0.0, 1.0]]))[0]
    wanted = [up[6] / 2, up[12] / 2 + up[20] / 8, 2**0.25, 0.3 + np.log2(255) / 255]
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_a_view_is_the_same_bytes_in_glsl() -> None:
    """Oracle: the fields that ctypes fills, which tests/raster/test_header.py compares with C. The
    shader sees the matrix transposed."""
    graphics.begin()
    view = header.ViewStruct(
        fy=3.0, height=50, near_plane=0.25, eps2d=0.3, sh_degree=4, outputs=9, antialias=1
    )
    view.viewmat[1 * 4 + 2] = 7.0
    view.background[2] = 0.5
    found = pixel((SHARED / "structs.h").read_text(encoding="utf-8"), VIEW, bytes(view))
    np.testing.assert_allclose(found, [60.25, 0.3, 4.0, 9.5], rtol=1e-6)
