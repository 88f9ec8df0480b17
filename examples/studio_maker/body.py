"""The figure's body as implicit shapes: trunk, arms, legs, hands, head, boots."""

import numpy as np

from .shapes import cone, cut, ellipsoid, limb, smooth_interp, stack, union

# The figure faces -y and its left is +x; metres, the floor is z = 0.
TRUNK = [  # height, half width, half depth, centre y
    (1.500, 0.050, 0.052, 0.016),
    (1.470, 0.052, 0.054, 0.018),
    (1.440, 0.078, 0.062, 0.022),
    (1.415, 0.122, 0.074, 0.020),
    (1.385, 0.152, 0.084, 0.015),
    (1.330, 0.158, 0.098, 0.006),
    (1.270, 0.149, 0.106, 0.000),
    (1.200, 0.134, 0.098, 0.002),
    (1.120, 0.118, 0.088, 0.003),
    (1.060, 0.116, 0.086, 0.005),
    (1.000, 0.136, 0.100, 0.007),
    (0.920, 0.166, 0.114, 0.012),
    (0.860, 0.168, 0.116, 0.014),
    (0.800, 0.150, 0.100, 0.012),
]
LEFT_ARM = [
    (0.155, 0.012, 1.382, 0.050),
    (0.272, 0.048, 1.140, 0.039),
    (0.246, -0.152, 1.068, 0.026),
]
RIGHT_ARM = [
    (-0.155, 0.012, 1.382, 0.050),
    (-0.285, 0.030, 1.130, 0.039),
    (-0.352, -0.060, 0.905, 0.026),
]
LEFT_LEG = [
    (0.088, 0.008, 0.880, 0.086),
    (0.094, 0.002, 0.690, 0.074),
    (0.098, 0.008, 0.480, 0.052),
    (0.100, 0.032, 0.370, 0.055),
    (0.104, 0.030, 0.200, 0.040),
    (0.105, 0.028, 0.090, 0.036),
]
RIGHT_LEG = [
    (-0.088, 0.008, 0.880, 0.086),
    (-0.098, -0.045, 0.690, 0.074),
    (-0.108, -0.085, 0.485, 0.052),
    (-0.112, -0.055, 0.370, 0.055),
    (-0.118, -0.048, 0.200, 0.040),
    (-0.120, -0.046, 0.090, 0.036),
]
HEAD = np.array([0.0, -0.004, 1.606])
HEAD_TURN = np.radians(14.0)


def trunk(p):
    """Trunk with bust."""
    d = stack(p, TRUNK)
    for x in (-0.064, 0.064):
        d = union(0.03, d, ellipsoid(p, (x, -0.072, 1.268), (0.056, 0.052, 0.058)))
    return d


def arm(p, joints):
    """Arm to the wrist, with the swell of deltoid and forearm."""
    s, e, w = (np.array(j[:3]) for j in joints)
    swell = [(*s, 0.052), (*(0.55 * s + 0.45 * e), 0.043), (*e, 0.037)]
    lower = [(*e, 0.037), (*(0.7 * e + 0.3 * w), 0.040), (*w, 0.025)]
    return union(0.01, limb(p, swell), limb(p, lower))


def body(p):
    """Collider of the clothes: trunk, arms and legs, without head, hands and feet."""
    d = trunk(p)
    for joints in (LEFT_ARM, RIGHT_ARM):
        d = union(0.04, d, arm(p, joints))
    for joints in (LEFT_LEG, RIGHT_LEG):
        d = union(0.03, d, limb(p, joints))
    return d


def hand_frame(joints):
    """Wrist and axes (along the hand, across towards the thumb, out of its back) of an arm."""
    elbow, wrist = np.array(joints[1][:3]), np.array(joints[2][:3])
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow) + (0, -0.05, -0.25)
    along /= np.linalg.norm(along)
    out = np.array([np.sign(wrist[0]), 0.0, 0.0])
    out -= along * (out @ along)
    out /= np.linalg.norm(out)
    across = np.cross(out, along)
    across *= -np.sign(across[1] or 1) if abs(across[1]) > abs(across[2]) else np.sign(across[2])
    return wrist, np.stack([along, across, out])


def hand(p, joints):
    """Relaxed hand: palm, four fingers of three bones, thumb."""
    wrist, axes = hand_frame(joints)
    q = (p - wrist.astype(p.dtype)) @ axes.T.astype(p.dtype)
    d = union(
        0.012,
        cone(q, (-0.06, 0, 0), (0.0, 0, 0), 0.029, 0.024),
        ellipsoid(q, (0.045, 0, 0), (0.052, 0.037, 0.014)),
        ellipsoid(q, (0.035, 0.024, -0.006), (0.034, 0.016, 0.014)),
    )
    for i, (side, length) in enumerate(
        ((0.029, 0.92), (0.010, 1.0), (-0.010, 0.95), (-0.028, 0.78))
    ):
        curl, at, joint = 0.25 + 0.10 * i, np.array([0.078 - 0.08 * abs(side), side, 0.002]), []
        for bone, radius in ((0.040, 0.0092), (0.026, 0.0085), (0.021, 0.0078)):
            joint.append((*at, radius))
            step = np.array(
                [np.cos(curl), 0.18 * np.sign(side) * (abs(side) > 0.02), -np.sin(curl)]
            )
            at, curl = at + bone * length * step, curl + 0.38
        d = union(0.006, d, limb(q, [*joint, (*at, 0.0068)]))
    thumb = [
        (0.015, 0.026, -0.004, 0.013),
        (0.052, 0.050, -0.016, 0.0105),
        (0.082, 0.056, -0.026, 0.0085),
    ]
    return union(0.012, d, limb(q, thumb))


def to_head(p):
    """World points in the frame of the head, which is turned slightly to the figure's left."""
    c, s = np.cos(HEAD_TURN), np.sin(HEAD_TURN)
    return (p - HEAD.astype(p.dtype)) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], p.dtype)


def from_head(p):
    """Points of the head's frame in the world."""
    c, s = np.cos(HEAD_TURN), np.sin(HEAD_TURN)
    return p @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], p.dtype).T + HEAD.astype(p.dtype)


def skull(q):
    """Head without face, in its own frame; the surface under the hair."""
    return union(
        0.03,
        ellipsoid(q, (0, 0.016, 0.032), (0.074, 0.094, 0.083)),
        ellipsoid(q, (0, -0.030, -0.028), (0.056, 0.060, 0.080)),
        cone(q, (0, 0.022, -0.05), (0, 0.026, -0.17), 0.050, 0.056),
    )


def head(q):
    """Head and neck in the head's frame."""
    x = np.concatenate([np.abs(q[..., :1]), q[..., 1:]], -1)  # symmetric features once
    d = skull(q)
    jaw = [
        (0.047, 0.000, -0.040, 0.017),
        (0.034, -0.038, -0.082, 0.014),
        (0, -0.074, -0.103, 0.0135),
    ]
    d = union(0.030, d, limb(x, jaw))
    d = union(0.020, d, ellipsoid(x, (0.042, -0.056, -0.022), (0.020, 0.022, 0.017)))
    d = union(0.020, d, limb(x, [(0, -0.080, 0.022, 0.009), (0.036, -0.070, 0.020, 0.009)]))
    d = cut(0.016, d, ellipsoid(x, (0.031, -0.096, 0.001), (0.020, 0.018, 0.011)))
    d = union(0.016, d, ellipsoid(q, (0, -0.072, -0.062), (0.030, 0.022, 0.028)))
    nose = limb(
        q, [(0, -0.082, 0.018, 0.0055), (0, -0.096, -0.018, 0.006), (0, -0.104, -0.031, 0.0075)]
    )
    d = union(
        0.012,
        d,
        union(
            0.008, nose, cone(x, (0.008, -0.095, -0.034), (0.010, -0.088, -0.034), 0.0062, 0.0055)
        ),
    )
    upper = limb(x, [(0, -0.0930, -0.0575, 0.0055), (0.022, -0.080, -0.0625, 0.0025)])
    lower = limb(x, [(0, -0.0920, -0.0695, 0.0070), (0.020, -0.080, -0.0650, 0.0025)])
    d = union(0.005, d, upper, lower)
    d = cut(0.003, d, limb(x, [(0, -0.1010, -0.0632, 0.0018), (0.024, -0.086, -0.0642, 0.0012)]))
    lid = ellipsoid(x, (0.031, -0.0725, 0.0), (0.0160, 0.0155, 0.0150))
    opening = ellipsoid(x, (0.031, -0.090, -0.0010), (0.0125, 0.020, 0.0050))
    d = union(0.004, d, cut(0.002, lid, opening))
    ear = cut(0.006, ellipsoid(x, (0.078, 0.014, -0.006), (0.009, 0.020, 0.031)),
              ellipsoid(x, (0.086, 0.010, -0.003), (0.006, 0.012, 0.019)))  # fmt: skip
    return union(0.006, d, ear)


def eyes(q):
    """Eyeballs in the head's frame."""
    return np.minimum(*(ellipsoid(q, (x, -0.0715, 0.0), (0.0132,) * 3) for x in (-0.031, 0.031)))


def boot(p, joints):
    """Ankle boot around the foot of a leg: shaft, vamp, sole and low heel."""
    x, y = joints[-1][0], joints[-1][1]
    q = p - np.array([x, y, 0], p.dtype)
    turn = np.sign(x) * 0.22
    c, s = np.cos(turn), np.sin(turn)
    q = q @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], p.dtype).T
    upper = union(
        0.03,
        limb(q, [(0, 0.004, 0.225, 0.052), (0, 0.004, 0.12, 0.045), (0, 0.012, 0.060, 0.042)]),
        limb(
            q,
            [
                (0, 0.014, 0.052, 0.036),
                (0, -0.070, 0.052, 0.037),
                (0.004, -0.125, 0.046, 0.036),
                (0.004, -0.165, 0.040, 0.028),
            ],
        ),
    )
    foot = q * np.array([1, 1, 0], p.dtype)
    sole = limb(
        foot,
        [
            (0, 0.016, 0, 0.038),
            (0, -0.060, 0, 0.034),
            (0.004, -0.122, 0, 0.042),
            (0.004, -0.168, 0, 0.030),
        ],
    )
    arch = smooth_interp(
        q[..., 1], np.array([-0.06, -0.02, 0.0], p.dtype), np.array([0.0, 0.016, 0.0], p.dtype)
    )
    sole = np.maximum(sole, np.maximum(q[..., 2] - 0.024, arch + 0.001 - q[..., 2]))
    upper = np.maximum(np.maximum(upper, 0.018 - q[..., 2]), q[..., 2] - 0.195)
    return np.minimum(upper, sole)
