"""Plugins of Mitsuba 3 that scripts/mitsuba_inverse.py needs: unbake's reflection models, and a sensor of any pixels of panoramas.

Import after mi.set_variant("llvm_ad_rgb"). Registers the BSDF `unbake` and the sensor `pixels`.
"""
import drjit as dr
import mitsuba as mi


def smith_visibility(n_l, n_v, alpha):
    """G/(4 n·l n·v) of the separable Smith masking of GGX."""
    a2 = alpha * alpha
    side = lambda x: x + dr.sqrt(dr.fma(1 - a2, x * x, a2))
    return dr.rcp(dr.maximum(side(n_l) * side(n_v), 1e-12))


def fresnel_fit(v_h):
    """Spherical-gaussian fit to Schlick's term, F0 = 0.04."""
    return 0.04 + 0.96 * dr.exp2((-5.55473 * v_h - 6.98316) * v_h)


def fresnel_exact(v_h):
    """Fresnel's equations for a refractive index of 1.5 (Cook and Torrance 1982)."""
    g = dr.sqrt(1.25 + v_h * v_h)
    s, p = (g - v_h) / (g + v_h), (v_h * (g + v_h) - 1) / (v_h * (g - v_h) + 1)
    return 0.5 * s * s * (1 + p * p)


class Unbake(mi.BSDF):
    """The models of src/core/brdf/reflectance.rs, on both sides of a surface; directions as its path tracer draws them.

    Lambert (`paper`, `smith`) or Burley 2012 (`burley`), plus GGX with α = R² and F0 = 0.04; `paper` has Karis' masking and a
    fit to Fresnel's equations. No metal, no panes.
    """

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.base, self.roughness, self.model = props["base_color"], props["roughness"], props.get("model", "paper")
        if self.model not in ("paper", "smith", "burley"):
            raise ValueError(f"reflection model {self.model}: expected paper, smith or burley")
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [mi.BSDFFlags.DiffuseReflection | sides | mi.BSDFFlags.SpatiallyVarying,
                             mi.BSDFFlags.GlossyReflection | sides | mi.BSDFFlags.SpatiallyVarying]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def traverse(self, callback):
        callback.put("base_color", self.base, mi.ParamFlags.Differentiable)
        callback.put("roughness", self.roughness, mi.ParamFlags.Differentiable)

    def material(self, si, active):
        return self.base.eval(si, active), dr.clip(self.roughness.eval_1(si, active), 0.01, 1)

    def share(self, n_v, albedo):
        """Probability of the specular lobe."""
        f = fresnel_fit(n_v)
        return dr.clip(dr.detach(f / (f + mi.luminance(albedo))), 0.1, 0.9)

    def lobes(self, v, l, albedo, rough):
        """BRDF · n·l and density; `v` and `l` on the side where z > 0."""
        n_v, n_l = v.z, l.z
        h = dr.normalize(v + l)
        v_h, sin2 = dr.clip(dr.dot(v, h), 0, 1), dr.minimum(h.x * h.x + h.y * h.y, 1)
        alpha = rough * rough
        q = alpha / dr.fma(alpha * alpha, 1 - sin2, sin2)
        distribution = q * q * dr.inv_pi
        diffuse = albedo * dr.inv_pi
        if self.model == "paper":
            k = dr.square(rough + 1) / 8
            specular = distribution * fresnel_fit(v_h) / (4 * dr.fma(n_l, 1 - k, k) * dr.fma(n_v, 1 - k, k))
        else:
            specular = distribution * fresnel_exact(v_h) * smith_visibility(n_l, n_v, alpha)
        if self.model == "burley":
            grazing = rough * (1 + dr.dot(v, l)) - 0.5
            diffuse *= dr.fma(grazing, (1 - n_l) ** 5, 1) * dr.fma(grazing, (1 - n_v) ** 5, 1)
        visible = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.detach(alpha), True)
        share = self.share(n_v, albedo)
        pdf = share * visible.pdf(v, h) / (4 * dr.maximum(v_h, 1e-6)) + (1 - share) * n_l * dr.inv_pi
        return (diffuse + specular) * n_l, dr.detach(pdf)

    def sample(self, ctx, si, sample1, sample2, active=True):
        albedo, rough = self.material(si, active)
        v = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        share = self.share(v.z, albedo)
        visible = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, rough * rough, True)
        h = visible.sample(v, sample2)[0]
        l = dr.select(sample1 < share, mi.reflect(v, h), mi.warp.square_to_cosine_hemisphere(sample2))
        value, pdf = self.lobes(v, l, albedo, rough)
        active &= (v.z > 0) & (l.z > 0) & (pdf > 0)
        bs = mi.BSDFSample3f()
        bs.wo = mi.Vector3f(l.x, l.y, dr.mulsign(l.z, si.wi.z))
        bs.pdf = dr.select(active, pdf, 0)
        bs.eta = 1.0
        bs.sampled_type = +mi.BSDFFlags.GlossyReflection
        bs.sampled_component = 1
        return bs, dr.select(active, value / pdf, 0)

    def eval_pdf(self, ctx, si, wo, active=True):
        albedo, rough = self.material(si, active)
        v = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        l = mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, si.wi.z))
        active &= (v.z > 0) & (l.z > 0)
        value, pdf = self.lobes(v, mi.Vector3f(l.x, l.y, dr.maximum(l.z, 1e-6)), albedo, rough)
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def eval(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def to_string(self):
        return f"Unbake[{self.model}]"


class Pixels(mi.Sensor):
    """Pixel i of the film looks through pixel (column, row) of panorama `view`, set by `aim`: any pixels of all views in one image.

    A panorama's centre looks along −z of its camera, its top along y; rows are polar angles.
    """

    def __init__(self, props):
        mi.Sensor.__init__(self, props)
        self.m_needs_sample_3 = False

    def place(self, poses, width, height):
        """`poses` are world_from_camera as arrays of 3 x 4, all panoramas have one size."""
        flat = lambda part: mi.Float(part.astype("float32").ravel())
        self.turns, self.origins = flat(poses[:, :, :3]), flat(poses[:, :, 3])
        self.width, self.height = dr.opaque(mi.Float, width), dr.opaque(mi.Float, height)

    def aim(self, view, column, row):
        """Arrays of whole numbers, one per pixel of the film."""
        self.view, self.column, self.row = map(mi.UInt32, (view, column, row))
        dr.eval(self.view, self.column, self.row)

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        size = self.film().size()
        x, y = sample2.x * size.x, sample2.y * size.y
        across = dr.minimum(dr.floor(x), size.x - 1)
        down = dr.minimum(dr.floor(y), size.y - 1)
        i = mi.UInt32(down) * int(size.x) + mi.UInt32(across)
        of = lambda what: dr.gather(mi.UInt32, what, i, active)
        view = of(self.view)
        phi = ((mi.Float(of(self.column)) + x - across) / self.width - 0.5) * dr.two_pi
        theta = (mi.Float(of(self.row)) + y - down) / self.height * dr.pi
        direction = mi.Vector3f(dr.sin(theta) * dr.sin(phi), dr.cos(theta), -dr.sin(theta) * dr.cos(phi))
        turn = [dr.gather(mi.Vector3f, self.turns, view * 3 + k, active) for k in range(3)]
        ray = mi.Ray3f(dr.gather(mi.Point3f, self.origins, view, active),
                       mi.Vector3f(*(dr.dot(r, direction) for r in turn)), time)
        return ray, mi.Color3f(1)

    def sample_ray_differential(self, time, sample1, sample2, sample3, active=True):
        ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
        return mi.RayDifferential3f(ray), weight

    def to_string(self):
        return "Pixels[]"


mi.register_bsdf("unbake", Unbake)
mi.register_sensor("pixels", Pixels)
