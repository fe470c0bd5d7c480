"""Tables as those of the RGL material database: matte, random and of a rough conductor.

Names as in J. Dupuy and W. Jakob, ACM Trans. Graph. 37, 274 (2018).
"""

import struct

import numpy as np

ALBEDO = 0.37
ANGLES, RADII = 16, 64


def write_table(path, **fields):
    """Write arrays as the RGL material database does."""
    kinds = {np.dtype("u1"): 1, np.dtype("f4"): 10}
    start = 18 + sum(13 + len(name) + 8 * array.ndim for name, array in fields.items())
    head = b"tensor_file\0" + bytes([1, 0]) + struct.pack("<I", len(fields))
    body = b""
    for name, array in fields.items():
        body += bytes(-(start + len(body)) % 8)
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack("<HBQ", array.ndim, kinds[array.dtype], start + len(body))
        head += struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.tobytes()
    path.write_bytes(head + body)
    return path


def matte_table(path):
    """Write the table of a matte coat: half vectors as they are, f cos = albedo cos / pi."""
    theta = np.linspace(0, 1, ANGLES) ** 2 * np.pi / 2
    u = np.linspace(0, 1, RADII)
    azimuth, polar = np.meshgrid((2 * u - 1) * np.pi, u**2 * np.pi / 2, indexing="ij")
    half = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth)])
    half = np.concatenate([half, np.cos(polar)[None]])
    outgoing = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    cosine = 2 * np.tensordot(outgoing, half, 1) * half[2] - outgoing[:, 2, None, None]
    scale = np.array([1.0, 3.0])[None, None, :, None, None]
    reflected = ALBEDO / np.pi * np.clip(cosine, 0, None)[None, :, None] * scale
    even = np.ones((1, ANGLES, RADII, RADII))
    return write_table(
        path,
        **table_fields(theta, np.zeros(1), np.array([500.0, 600.0]), reflected, even),
        ndf=np.ones((2, 2), "f4"),
        sigma=np.ones((2, 2), "f4"),
        jacobian=np.zeros(1, "u1"),
    )


def table_fields(theta, phi, wavelengths, spectra, lobe):
    arrays = {"theta_i": theta, "phi_i": phi, "wavelengths": wavelengths, "spectra": spectra}
    arrays |= {"vndf": lobe, "luminance": lobe}
    fields = {name: np.asarray(array, "f4") for name, array in arrays.items()}
    return {"description": np.frombuffer(b"test", "u1"), **fields}


def random_table(path, turns):
    """Write a table of random lobes; those of an isotropic one do not depend on the azimuth."""
    rng = np.random.default_rng(4)
    phi = np.zeros(1) if turns == 1 else np.linspace(-np.pi, np.pi, turns)
    theta = np.linspace(0, 1, 8) ** 2 * np.pi / 2
    lobe, spectra = rng.uniform(0.5, 1.5, (turns, 8, 9, 9)), rng.random((turns, 8, 3, 9, 9))
    rows = 1 if turns == 1 else 9
    face = np.broadcast_to(rng.uniform(0.5, 1.5, (2, rows, 9)), (2, 9, 9)).astype("f4")
    return write_table(
        path,
        **table_fields(theta, phi, np.array([400.0, 500.0, 600.0]), spectra, lobe),
        ndf=face[0],
        sigma=face[1],
        jacobian=np.ones(1, "u1"),
    )


def glossy_table(path, alpha, turns=1, size=64):
    """Write the table of a GGX conductor with reflectance 1: f cos = D G / (4 cos theta_i).

    `alpha` is the roughness, `turns` the number of azimuths (1: an isotropic table), `size` the
    number of values along both axes of half vectors.
    """
    theta, phi = np.linspace(0, 1, ANGLES) ** 2 * np.pi / 2, np.linspace(-np.pi, np.pi, turns)
    theta[-1] = np.deg2rad(89.0)  # at 90 degrees nothing is visible
    phi = phi if turns > 1 else np.zeros(1)
    u = np.linspace(0, 1, size)
    half = half_vectors(*np.meshgrid(u, u))
    ndf = alpha**2 / (np.pi * ((alpha**2 - 1) * half[2] ** 2 + 1) ** 2)
    azimuth, polar = np.meshgrid(phi, theta, indexing="ij")
    toward = np.clip(np.tensordot(direction(polar, azimuth), half, (0, 0)), 0, None)
    area = 2 * np.pi**2 * u * np.sin(u**2 * np.pi / 2)  # solid angle per area of the unit square
    lobe = (toward * ndf * np.maximum(area, 1e-6)).astype("f4")
    visible = shadowing(lobe, phi, theta, alpha)
    cosine = np.cos(u**2 * np.pi / 2)
    sigma = np.broadcast_to(np.maximum(cosine, 1e-3) / masking(cosine, alpha), (size, size))
    spectra = np.repeat(visible[:, :, None], 2, axis=2)
    return write_table(
        path,
        **table_fields(theta, phi, np.array([500.0, 600.0]), spectra, lobe),
        ndf=ndf.astype("f4"),
        sigma=sigma.astype("f4"),
        jacobian=np.ones(1, "u1"),
    )


def shadowing(lobe, phi, theta, alpha):
    """Return G2 / G1 at the places of the spectra, which follow from the lobes, (phi, theta, ...).

    Smith's form without correlation: the masking of the reflected direction.
    """
    import mitsuba as mi

    warp = mi.MarginalContinuous2D2(lobe, [phi.tolist(), theta.tolist()])
    u = np.linspace(0, 1, lobe.shape[-1])
    y, x = (axis.ravel() for axis in np.meshgrid(u, u, indexing="ij"))
    visible = np.zeros(lobe.shape)
    for i, j in np.ndindex(lobe.shape[:2]):
        # Arrays, not literals: one kernel for all angles.
        at = mi.Vector2f(np.full(x.size, phi[i]), np.full(x.size, theta[j]))
        wi = direction(theta[j], phi[i])
        normal = half_vectors(*np.array(warp.sample(mi.Point2f(x, y), at)[0]))
        height = (2 * (wi @ normal) * normal - wi[:, None])[2]
        visible[i, j] = np.where(height > 0, masking(height, alpha), 0.0).reshape(lobe.shape[2:])
    return visible


def direction(polar, azimuth):
    """Return unit vectors from their angle to the normal and their azimuth, (xyz, ...)."""
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)])


def half_vectors(x, y):
    """Return the unit vectors of places in the unit square, (xyz, ...)."""
    return direction(x**2 * np.pi / 2, (2 * y - 1) * np.pi)


def masking(cosine, alpha):
    """Return Smith's visible share of GGX facets under an angle."""
    tangent2 = 1 / np.maximum(cosine, 1e-3) ** 2 - 1
    return 2 / (1 + np.sqrt(1 + alpha**2 * tangent2))
