"""The clothed figure: meshes, draped garments, hair and their materials."""

import numpy as np

from . import body, garments, hair, textures
from .blender import add_image, add_mesh, add_strands, material
from .shapes import mesh, smooth_interp

SKIN = np.array([0.60, 0.33, 0.23])
HAIR = np.array([0.075, 0.030, 0.014])


def build(rng, coarse=False):
    """Add the figure to the scene; `coarse`: cloth with fewer vertices, for a preview."""
    skin = material("skin", tint=True, roughness=0.5)
    add_head(skin, rng)
    boots = material(
        "boots",
        image=add_image("leather", textures.leather(512, rng, np.array([0.33, 0.17, 0.10]))),
        roughness=0.45,
    )
    for joints in (body.LEFT_LEG, body.RIGHT_LEG):
        add_leg(joints, boots, rng)
    for joints in (body.LEFT_ARM, body.RIGHT_ARM):
        wrist, _ = body.hand_frame(joints)
        v, f = mesh(lambda p, joints=joints: body.hand(p, joints), wrist - 0.2, wrist + 0.2, 0.003)
        add_mesh("hand", v, f, skin, tint=np.tile(SKIN, (len(v), 1)))
    v, f = mesh(body.body, (-0.45, -0.30, 0.0), (0.45, 0.25, 1.50), 0.010)
    add_clothes(add_mesh("body", v, f, skin, tint=np.tile(SKIN, (len(v), 1))), rng, coarse)


def add_head(skin, rng):
    """Head with painted lips, brows and scalp, eyes, hair."""
    q, f = mesh(body.head, (-0.11, -0.14, -0.18), (0.11, 0.14, 0.14), 0.0025)
    tint = np.tile(SKIN, (len(q), 1))
    x = np.abs(q[:, 0])

    def paint(color, weight):
        tint[:] += np.clip(weight, 0, 1)[:, None] * (np.asarray(color) - tint)

    front = q[:, 1] < -0.05
    paint(
        (0.62, 0.20, 0.14),
        0.5 * front * np.exp(-(((x - 0.040) / 0.016) ** 2) - ((q[:, 2] + 0.028) / 0.014) ** 2),
    )
    mouth = 1.3 - np.hypot(x / 0.021, (q[:, 2] + 0.0635) / 0.0085)
    paint((0.42, 0.09, 0.08), 3 * front * mouth)
    brow = 0.0024 - np.abs(
        q[:, 2]
        - smooth_interp(x, np.array([0.012, 0.03, 0.05]), np.array([0.0175, 0.0225, 0.0165]))
    )
    paint(HAIR, front * (brow > 0) * ((x > 0.012) & (x < 0.048)) * 0.75)
    paint(HAIR * 0.8, hair.above_hairline(q) / 0.004)
    for spot in rng.normal((0, -0.09, -0.022), (0.028, 0.02, 0.010), (26, 3)):
        paint(
            (0.36, 0.17, 0.10),
            0.5 * front * (np.hypot(q[:, 0] - spot[0], q[:, 2] - spot[2]) < 0.0016),
        )
    add_mesh("head", body.from_head(q), f, skin, tint=tint)
    q, f = mesh(body.eyes, (-0.06, -0.10, -0.03), (0.06, -0.05, 0.03), 0.0012)
    x = np.abs(q[:, 0]) - 0.031
    r = np.where(q[:, 1] < -0.0715, np.hypot(x, q[:, 2]), 1)[:, None]
    tint = np.where(
        r < 0.0026, (0.01, 0.01, 0.01), np.where(r < 0.0062, (0.10, 0.17, 0.14), (0.80, 0.78, 0.75))
    )
    add_mesh("eyes", body.from_head(q), f, material("eyes", tint=True, roughness=0.1), tint=tint)
    dark = material("hair", color=HAIR, roughness=0.5)
    add_strands("hair", *hair.grow(rng), dark)


def add_leg(joints, boots, rng):
    """Stocking and boot of one leg."""
    x, y = joints[-1][0], joints[-1][1]
    v, f = mesh(
        lambda p: body.boot(p, joints),
        (x - 0.15, y - 0.30, -0.01),
        (x + 0.15, y + 0.15, 0.26),
        0.005,
    )
    v[:, 2] += 0.012
    uv = np.stack([v[f][..., 1] * 3, v[f][..., 2] * 3 + v[f][..., 0]], -1)
    add_mesh("boot", v, f, boots, uv=uv)
    v, f = mesh(
        lambda p: body.limb(p, joints) - 0.002,
        (x - 0.15, y - 0.20, 0.1),
        (x + 0.15, y + 0.20, 0.55),
        0.006,
    )
    turn = np.arctan2(v[f][..., 1] - y, v[f][..., 0] - x)
    turn = turn[:, :1] + (turn - turn[:, :1] + np.pi) % (2 * np.pi) - np.pi
    wool = material(
        "stocking",
        image=add_image("knit", textures.knit(1024, rng)),
        roughness=0.95,
        sheen_weight=0.3,
    )
    add_mesh("stocking", v, f, wool, uv=np.stack([turn * 0.1, v[f][..., 2] * 2], -1))


def add_clothes(skin_body, rng, coarse):
    """Drape and colour skirt and blouse, add belt, cuffs and collar."""
    v, f, uv = garments.belt()
    image = add_image(
        "belt", textures.leather(512, rng, np.array([0.20, 0.09, 0.05]), (0.16, 0.84))
    )
    belt = add_mesh(
        "belt", v, f, material("belt", image=image, roughness=0.4), uv=uv * (3, 20) + (0, 0.5)
    )
    add_buckle()
    span = 1.86
    v, f, uv = garments.skirt(skin_body, rng, **({"rows": 30, "columns": 160} if coarse else {}))
    hem = np.linalg.norm(uv, axis=-1).max()
    image = add_image("plaid", textures.plaid(2048, span, rng, hem))
    wool = material("wool", image=image, roughness=0.9, sheen_weight=0.25)
    refine(add_mesh("skirt", v, f, wool, uv=uv / span + 0.5))
    v, f, uv = garments.blouse(skin_body, [belt], 0.015 if coarse else 0.0085)
    cotton = material(
        "cotton",
        image=add_image("print", textures.blossoms(2048, rng)),
        roughness=0.85,
        sheen_weight=0.15,
    )
    refine(add_mesh("blouse", v, f, cotton, uv=uv))
    plain = material("binding", color=(0.32, 0.035, 0.04), roughness=0.7)
    add_mesh("collar", *garments.binding(v, f, lambda p: p[2] > 1.40), plain)
    for joints in (body.LEFT_ARM, body.RIGHT_ARM):
        refine(add_mesh("cuff", *garments.cuff_rings(joints), plain))


def refine(item):
    """Subdivide a draped mesh once when it is rendered."""
    modifier = item.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = 1


def add_buckle():
    """Brass buckle on the belt: a rounded frame with a tongue."""
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    c, s = np.cos(turn), np.sin(turn)
    r = (np.abs(c) ** 6 + np.abs(s) ** 6) ** (-1 / 6)
    front = garments.ring(garments.WAIST, 0.022, 4)[2]
    frame = np.stack([0.030 * r * c, 0 * c, 0.029 * r * s], -1) + front
    out = np.stack([c, 0 * c, s], -1)
    small = np.linspace(0, 2 * np.pi, 8, endpoint=False)[:, None, None]
    tube = frame + 0.004 * (np.cos(small) * out + np.sin(small) * np.array([0, 1.0, 0]))
    faces = garments.grid_faces(9, 48) % (8 * 48)
    brass = material("brass", color=(0.62, 0.42, 0.14), metallic=1.0, roughness=0.3)
    add_mesh("buckle", tube.reshape(-1, 3), faces, brass)
    bar = [(0.0, 0.0, 0.0, 0.0035), (0.030, -0.004, 0.0, 0.003)]
    v, f = mesh(lambda p: body.limb(p, bar), (-0.01, -0.01, -0.01), (0.04, 0.01, 0.01), 0.001)
    add_mesh("tongue", v + front, f, brass)
