"""The BRDF of Blender's Principled shader, as far as the method uses it: Lambert diffuse under a GGX reflection.

Directions are unit vectors away from the surface: v to the eye, l to the light, h their half-vector, n the normal. All
functions take cosines, or local vectors whose z axis is n. `roughness` is Principled's; alpha = roughness^2 is GGX's.

This module follows Cycles (Principled v2, default inputs: IOR 1.5, specular level 0.5, white tint):
- height-correlated Smith masking (Heitz 2014, eq. 99);
- metal: Schlick's Fresnel from the Base Color (F82 tint with a white edge is Schlick's);
- dielectric: the exact Fresnel equations for the specular lobe; the diffuse lobe below it is scaled by 1 - E_dielectric(v),
  the share that the specular lobe does not reflect towards the eye (albedo scaling);
- Multiscatter GGX: the single-scattering lobe is scaled by 1 + F_ms (1 - E) / E (Turquin 2019, Kulla & Conty 2017).
There is one difference: Cycles reads E from a 32-point fit; here E is tabulated by quadrature. The two agree within 0.005.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch

IOR = 1.5
"""Index of refraction; Principled's default."""
DIELECTRIC_FSS = (IOR - 1) / (4.08567 + 1.00071 * IOR)
"""Cosine-weighted mean Fresnel reflectance of a dielectric (fit by d'Eon & Irving 2011)."""
MIN_ROUGHNESS = 0.02
"""Smallest roughness. Below it, a lobe is narrower than any pixel's cone, and alpha^2 loses digits in float32."""
_TABLE = 32


def alpha_of(roughness: torch.Tensor) -> torch.Tensor:
    """GGX alpha from Principled's roughness, which is clamped to MIN_ROUGHNESS..1."""
    return roughness.clamp(MIN_ROUGHNESS, 1.0) ** 2


def ggx_d(cos_h: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """GGX normal distribution D(h) [1/sr] (Walter 2007, eq. 33), in a form that is exact for small alpha."""
    squared = alpha * alpha
    # 1 - cos^2 is written as (1-c)(1+c), so that nothing cancels near the pole.
    base = cos_h * cos_h * squared + (1 - cos_h) * (1 + cos_h)
    return squared / (math.pi * base * base)


def smith_lambda(cosine: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Smith's auxiliary function of GGX (Heitz 2014, eq. 72)."""
    squared = (cosine * cosine).clamp_min(1e-12)
    return 0.5 * ((1 + alpha * alpha * (1 - squared).clamp_min(0) / squared).sqrt() - 1)


def smith_g1(cosine: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Smith's masking of GGX in one direction, 0..1."""
    return 1 / (1 + smith_lambda(cosine, alpha))


def smith_g2(cos_v: torch.Tensor, cos_l: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Smith's height-correlated masking and shadowing of GGX, 0..1 (Heitz 2014, eq. 99)."""
    return 1 / (1 + smith_lambda(cos_v, alpha) + smith_lambda(cos_l, alpha))


def schlick_weight(cos_vh: torch.Tensor) -> torch.Tensor:
    """(1 - v.h)^5. Schlick's Fresnel reflectance is F0 + (1 - F0) times this weight."""
    return (1 - cos_vh).clamp(0, 1) ** 5


def dielectric_fresnel(cos_vh: torch.Tensor, ior: float = IOR) -> torch.Tensor:
    """Unpolarised Fresnel reflectance of a dielectric seen from outside, 0..1."""
    c = cos_vh.clamp(0, 1)
    g = (ior * ior - 1 + c * c).sqrt()
    a = (g - c) / (g + c)
    b = (c * (g + c) - 1) / (c * (g - c) + 1)
    return 0.5 * a * a * (1 + b * b)


def specular(cos_v: torch.Tensor, cos_l: torch.Tensor, cos_h: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Single-scattering GGX lobe D G2 / (4 v.n l.n) [1/sr] without Fresnel; 0 below the horizon."""
    lobe = ggx_d(cos_h, alpha) * smith_g2(cos_v, cos_l, alpha) / (4 * cos_v.clamp_min(1e-6) * cos_l.clamp_min(1e-6))
    return torch.where((cos_v > 0) & (cos_l > 0), lobe, torch.zeros_like(lobe))


def multiscatter_scale(fss: torch.Tensor | float, cos_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """Factor of the single-scattering lobe that adds the light that is scattered more than once.

    fss is the mean Fresnel reflectance; it is broadcast against cos_v and roughness [...].
    """
    e, e_average = specular_albedo(cos_v, roughness), average_specular_albedo(roughness)
    fms = fss * e_average / (1 - fss * (1 - e_average))
    return 1 + fms * (1 - e) / e


def metal_fss(albedo: torch.Tensor) -> torch.Tensor:
    """Mean of Schlick's Fresnel over the cosine-weighted hemisphere: F0 + (1 - F0) / 21."""
    return albedo + (1 - albedo) / 21


def evaluate(
    v: torch.Tensor, light: torch.Tensor, albedo: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor
) -> torch.Tensor:
    """The BRDF f_r(v, l) [..., 3] in 1/sr.

    v, light [..., 3] are local unit directions; albedo [..., 3]; roughness, metallic [...].
    """
    h = torch.nn.functional.normalize(v + light, dim=-1)
    cos_v, cos_l, cos_h, cos_vh = v[..., 2], light[..., 2], h[..., 2], (v * h).sum(-1)
    lobe = specular(cos_v, cos_l, cos_h, alpha_of(roughness))
    fresnel = albedo + (1 - albedo) * schlick_weight(cos_vh)[..., None]
    metal = fresnel * multiscatter_scale(metal_fss(albedo), cos_v[..., None], roughness[..., None]) * lobe[..., None]
    dielectric = dielectric_fresnel(cos_vh) * multiscatter_scale(DIELECTRIC_FSS, cos_v, roughness) * lobe
    diffuse = albedo * (1 - dielectric_albedo(cos_v, roughness))[..., None] / math.pi
    diffuse = torch.where(((cos_v > 0) & (cos_l > 0))[..., None], diffuse, torch.zeros_like(diffuse))
    m = metallic[..., None]
    return m * metal + (1 - m) * (dielectric[..., None] + diffuse)


def sample_cosine(u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Cosine-weighted directions from u [..., 2] in [0,1): (local l [..., 3], pdf [...] in 1/sr)."""
    radius, phi = u[..., 0].sqrt(), 2 * math.pi * u[..., 1]
    z = (1 - u[..., 0]).clamp_min(0).sqrt()
    return torch.stack([radius * phi.cos(), radius * phi.sin(), z], -1), z / math.pi


def sample_vndf(v: torch.Tensor, alpha: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sample half-vectors from GGX's visible normals (Dupuy & Benyoub 2023, spherical caps).

    v [..., 3] is local with v.z > 0; alpha [...]; u [..., 2] in [0, 1). Returns local h [..., 3], and the pdf [...] in 1/sr
    of the direction that is v reflected about h.
    """
    stretched = torch.nn.functional.normalize(torch.stack([alpha * v[..., 0], alpha * v[..., 1], v[..., 2]], -1), dim=-1)
    phi = 2 * math.pi * u[..., 0]
    z = (1 - u[..., 1]) * (1 + stretched[..., 2]) - stretched[..., 2]
    sine = ((1 - z) * (1 + z)).clamp_min(0).sqrt()
    cap = torch.stack([sine * phi.cos(), sine * phi.sin(), z], -1) + stretched
    h = torch.stack([alpha * cap[..., 0], alpha * cap[..., 1], cap[..., 2].clamp_min(1e-9)], -1)
    h = torch.nn.functional.normalize(h, dim=-1)
    return h, vndf_pdf(v[..., 2], h[..., 2], alpha)


def vndf_pdf(cos_v: torch.Tensor, cos_h: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Density [1/sr] of the direction reflected about a visible normal: D G1(v) / (4 v.n)."""
    return ggx_d(cos_h, alpha) * smith_g1(cos_v, alpha) / (4 * cos_v.clamp_min(1e-6))


def reflect(v: torch.Tensor, h: torch.Tensor) -> torch.Tensor:
    """v mirrored about h, [..., 3]. v and the result both point away from the surface."""
    return 2 * (v * h).sum(-1, keepdim=True) * h - v


def frame(n: torch.Tensor) -> torch.Tensor:
    """Orthonormal frames [..., 3, 3] whose columns are tangent, bitangent, n (Duff et al. 2017)."""
    sign = torch.where(n[..., 2] < 0, -1.0, 1.0).to(n.dtype)
    a = -1 / (sign + n[..., 2])
    b = n[..., 0] * n[..., 1] * a
    tangent = torch.stack([1 + sign * n[..., 0] ** 2 * a, sign * b, -sign * n[..., 0]], -1)
    bitangent = torch.stack([b, sign + n[..., 1] ** 2 * a, -n[..., 1]], -1)
    return torch.stack([tangent, bitangent, n], -1)


def specular_albedo(cos_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """E(v): directional albedo of the single-scattering lobe without Fresnel, 0..1."""
    return _look_up(_tables()[0], cos_v, roughness)


def dielectric_albedo(cos_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """Directional albedo of the dielectric's specular lobe, multiple scattering included, 0..1."""
    return _look_up(_tables()[1], cos_v, roughness)


def average_specular_albedo(roughness: torch.Tensor) -> torch.Tensor:
    """E_avg: cosine-weighted mean of E(v) over the hemisphere, 0..1."""
    average = _tables()[2].to(roughness.device, roughness.dtype)
    x = (roughness.clamp(0, 1) * (_TABLE - 1)).clamp(0, _TABLE - 1 - 1e-4)
    i = x.long()
    return torch.lerp(average[i], average[i + 1], x - i)


def _look_up(table: torch.Tensor, cos_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """Bilinear lookup in a table; differentiable in both cos_v and roughness.

    The rows are roughness. The columns are sqrt(cos_v), so that they are denser at grazing angles.
    """
    table = table.to(roughness.device, roughness.dtype)
    y, x = roughness.clamp(0, 1) * (_TABLE - 1), cos_v.clamp(1e-6, 1).sqrt() * (_TABLE - 1)
    x, y = x.clamp(0, _TABLE - 1 - 1e-4), y.clamp(0, _TABLE - 1 - 1e-4)
    i, j = y.long(), x.long()
    fy, fx = y - i, x - j
    # Of one roughness, the rows are interpolated first. That leaves half of the lookups.
    if roughness.numel() == 1 and roughness.dim() <= cos_v.dim():
        row = torch.lerp(table[i.reshape(1)], table[i.reshape(1) + 1], fy.reshape(1, 1))[0]
        return torch.lerp(row[j], row[j + 1], fx)
    near = torch.lerp(table[i, j], table[i, j + 1], fx)
    return torch.lerp(near, torch.lerp(table[i + 1, j], table[i + 1, j + 1], fx), fy)


@lru_cache(maxsize=1)
def _tables() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Tables on the CPU, float32: E [T, T], E of the dielectric lobe [T, T] and E_avg [T].

    They are computed by stratified quadrature over samples of the visible normals. The lobe is symmetric to the plane of v
    and n, so half of the azimuths are enough.
    """
    axis = torch.linspace(0, 1, _TABLE, dtype=torch.float64)
    side = 48
    strata = (torch.arange(side, dtype=torch.float64) + 0.5) / side
    u = torch.stack(torch.meshgrid(strata[: side // 2], strata, indexing="ij"), -1).reshape(-1, 2).expand(_TABLE, -1, 2)
    cosine = (axis**2).clamp_min(1e-4)[:, None].expand(u.shape[:-1])
    v = torch.stack([(1 - cosine**2).sqrt(), torch.zeros_like(cosine), cosine], -1)
    albedo, dielectric_single = [], []
    for alpha in alpha_of(axis):  # one roughness after the other: what is computed at once stays in the processor's cache
        h, _ = sample_vndf(v, alpha, u)
        cos_l = reflect(v, h)[..., 2]
        weight = smith_g2(cosine, cos_l, alpha) / smith_g1(cosine, alpha) * (cos_l > 0)
        albedo.append(weight.mean(-1))
        dielectric_single.append((weight * dielectric_fresnel((v * h).sum(-1))).mean(-1))
    e, single = torch.stack(albedo), torch.stack(dielectric_single)
    mu = axis**2  # E_avg is the integral of 2 mu E(mu) dmu with mu = axis^2
    average = torch.trapezoid(2 * mu * e * 2 * axis, axis, dim=1)
    average = average / torch.trapezoid(2 * mu * 2 * axis, axis)
    fms = DIELECTRIC_FSS * average / (1 - DIELECTRIC_FSS * (1 - average))
    dielectric = single * (1 + fms[:, None] * (1 - e) / e)
    return e.float(), dielectric.float(), average.float()
