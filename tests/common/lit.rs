//! Scenes of lit quads in memory, and the closed forms that irradiance in them has to meet.

use glam::{DVec3, Vec2, Vec3};
use unbake::core::geometry::Mesh;
use unbake::core::image::Plane;
use unbake::core::trace::{EmbreeTracer, Tracer};
use unbake::gbuffer::Orientation;
use unbake::irradiance::{Bake, Receiver};
use unbake::lights::{Emitters, LitScene};
use unbake::radiance::{Environment, LightField, SurfaceRadiance};

/// Texels along a quad's cell of the atlas: a multiple of the coarsest mip's texels, so that no
/// lookup mixes two quads.
const CELL: usize = 16;

/// A parallelogram of constant radiance; it faces along `edge_u × edge_v`.
#[derive(Clone, Copy, Debug)]
pub struct Quad {
    /// One corner.
    pub corner: Vec3,
    /// Edges from that corner.
    pub edge_u: Vec3,
    /// Edges from that corner.
    pub edge_v: Vec3,
    /// Radiance sent out.
    pub radiance: Vec3,
    /// Whether that is emission.
    pub emits: bool,
}

impl Quad {
    /// The four corners in order.
    pub fn corners(&self) -> [Vec3; 4] {
        let (c, u, v) = (self.corner, self.edge_u, self.edge_v);
        [c, c + u, c + u + v, c + v]
    }

    /// Unit normal of the front.
    pub fn normal(&self) -> Vec3 {
        self.edge_u.cross(self.edge_v).normalize()
    }

    /// A point by fractions of the edges.
    pub fn at(&self, u: f32, v: f32) -> Vec3 {
        self.corner + self.edge_u * u + self.edge_v * v
    }

    /// The quad seen from its other side.
    pub fn flipped(self) -> Self {
        Self {
            edge_u: self.edge_v,
            edge_v: self.edge_u,
            ..self
        }
    }
}

/// A wall or lamp.
pub fn quad(
    corner: [f32; 3],
    edge_u: [f32; 3],
    edge_v: [f32; 3],
    radiance: f32,
    emits: bool,
) -> Quad {
    Quad {
        corner: corner.into(),
        edge_u: edge_u.into(),
        edge_v: edge_v.into(),
        radiance: Vec3::splat(radiance),
        emits,
    }
}

/// The six walls of a box seen from inside: floor, ceiling, x−, x+, z−, z+.
pub fn box_quads(lo: Vec3, hi: Vec3, radiance: f32) -> Vec<Quad> {
    let s = hi - lo;
    let (x, y, z) = (Vec3::X * s.x, Vec3::Y * s.y, Vec3::Z * s.z);
    let wall = |corner: Vec3, edge_u: Vec3, edge_v: Vec3| Quad {
        corner,
        edge_u,
        edge_v,
        radiance: Vec3::splat(radiance),
        emits: false,
    };
    vec![
        wall(lo, z, x),
        wall(lo + y, x, z),
        wall(lo, y, z),
        wall(lo + x, z, y),
        wall(lo, x, y),
        wall(lo + z, y, x),
    ]
}

/// The same walls without floor … z+ number `missing`, whose place a frame around an opening takes;
/// see [`framed`].
pub fn framed(wall: Quad, lo: Vec2, hi: Vec2) -> Vec<Quad> {
    let part = |a: Vec2, b: Vec2| Quad {
        corner: wall.at(a.x, a.y),
        edge_u: wall.edge_u * (b.x - a.x),
        edge_v: wall.edge_v * (b.y - a.y),
        ..wall
    };
    [
        part(Vec2::ZERO, Vec2::new(lo.x, 1.0)),
        part(Vec2::new(hi.x, 0.0), Vec2::ONE),
        part(Vec2::new(lo.x, 0.0), Vec2::new(hi.x, lo.y)),
        part(Vec2::new(lo.x, hi.y), Vec2::new(hi.x, 1.0)),
    ]
    .into_iter()
    .filter(|q| q.edge_u.length() > 1e-6 && q.edge_v.length() > 1e-6)
    .collect()
}

/// A mesh of two triangles per quad; quad i owns triangles 2i and 2i+1 and one cell of the atlas.
pub fn mesh_of(quads: &[Quad]) -> Mesh {
    let grid = (quads.len() as f32).sqrt().ceil().max(1.0);
    let mut mesh = Mesh::default();
    for (i, q) in quads.iter().enumerate() {
        let cell = Vec2::new((i % grid as usize) as f32, (i / grid as usize) as f32);
        let base = mesh.positions.len() as u32;
        for (corner, uv) in
            q.corners()
                .into_iter()
                .zip([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]])
        {
            mesh.positions.push(corner);
            mesh.uvs.push((cell + Vec2::from(uv)) / grid);
            mesh.normals.push(q.normal());
        }
        mesh.triangles
            .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    mesh
}

/// The radiance texture of [`mesh_of`]'s atlas.
pub fn radiance_of(quads: &[Quad], value: impl Fn(&Quad) -> Vec3) -> Plane<Vec3> {
    let grid = (quads.len() as f32).sqrt().ceil().max(1.0) as usize;
    let side = grid * CELL;
    let data = (0..side * side)
        .map(|i| {
            quads
                .get(i % side / CELL + grid * (i / side / CELL))
                .map_or(Vec3::ZERO, &value)
        })
        .collect();
    Plane {
        width: side,
        height: side,
        data,
    }
}

/// A scene ready for rays.
pub struct Lit {
    /// Geometry.
    pub mesh: Mesh,
    /// Embree.
    pub tracer: EmbreeTracer,
    /// Radiance along rays.
    pub field: LightField,
    /// Emitters.
    pub emitters: Emitters,
}

impl Lit {
    /// Quads that face the way they are wound, before an environment.
    pub fn new(quads: &[Quad], environment: Environment) -> Self {
        let mesh = mesh_of(quads);
        let orientation = Orientation::of_winding(mesh.triangles.len());
        Self::with(mesh, quads, &orientation, Vec::new(), environment)
    }

    /// With every choice given.
    pub fn with(
        mesh: Mesh,
        quads: &[Quad],
        orientation: &Orientation,
        back: Vec<Vec3>,
        environment: Environment,
    ) -> Self {
        let tracer = EmbreeTracer::new(&mesh).expect("Embree");
        let radiance = radiance_of(quads, |q| q.radiance);
        let emissive = radiance_of(quads, |q| if q.emits { Vec3::ONE } else { Vec3::ZERO })
            .map(|v| *v != Vec3::ZERO);
        let triangles: Vec<bool> = quads.iter().flat_map(|q| [q.emits; 2]).collect();
        let field = LightField::new(
            &mesh,
            orientation,
            SurfaceRadiance {
                radiance,
                emissive,
                emissive_triangles: &triangles,
                back,
            },
            environment,
        );
        // as many points as the pipeline's coarse irradiance texture would give
        let side = |t: usize| orientation.sign(t);
        let probes: Vec<(Vec3, Vec3)> = quads
            .iter()
            .enumerate()
            .filter(|(_, q)| !q.emits)
            .flat_map(|(i, q)| {
                receivers_on(q, 40)
                    .into_iter()
                    .map(move |r| (r.position, r.normal * side(2 * i)))
            })
            .collect();
        let emitters = Emitters::new(&mesh, &field, &tracer, &probes);
        Self {
            mesh,
            tracer,
            field,
            emitters,
        }
    }

    /// What irradiance bakes take.
    pub fn bake(&self) -> Bake<'_> {
        self.lit().into()
    }

    /// What gathering rays take.
    pub fn lit(&self) -> LitScene<'_> {
        let (lo, hi) = self.mesh.bounds();
        let offset = (hi - lo).length() * 1e-5;
        LitScene {
            mesh: &self.mesh,
            tracer: &self.tracer,
            field: &self.field,
            emitters: &self.emitters,
            offset,
        }
    }
}

/// `n × n` receivers on the front of a quad, at the centres of a grid.
pub fn receivers_on(q: &Quad, n: usize) -> Vec<Receiver> {
    (0..n * n)
        .map(|i| {
            let at = |k: usize| (k as f32 + 0.5) / n as f32;
            Receiver {
                position: q.at(at(i % n), at(i / n)),
                normal: q.normal(),
                face_normal: q.normal(),
                key: i as u64,
            }
        })
        .collect()
}

/// Irradiance per unit radiance at `p` with normal `n` from a polygon that sends light from both
/// sides: Lambert's formula over the part above the horizon, in f64.
pub fn lambert(polygon: &[Vec3], p: Vec3, n: Vec3) -> f64 {
    let (p, n) = (p.as_dvec3(), n.as_dvec3());
    let all: Vec<DVec3> = polygon.iter().map(|v| v.as_dvec3() - p).collect();
    let mut above = Vec::new();
    for (i, &a) in all.iter().enumerate() {
        let b = all[(i + 1) % all.len()];
        let (da, db) = (a.dot(n), b.dot(n));
        if da >= 0.0 {
            above.push(a);
        }
        if (da >= 0.0) != (db >= 0.0) {
            above.push(a + (b - a) * (da / (da - db)));
        }
    }
    let mut sum = 0.0;
    for (i, &a) in above.iter().enumerate() {
        let b = above[(i + 1) % above.len()];
        let axis = a.cross(b);
        if axis.length() > 0.0 {
            sum += a.angle_between(b) * axis.normalize().dot(n);
        }
    }
    0.5 * sum.abs()
}

/// Irradiance at `p` from the front of a quad by midpoint quadrature in f64, with a radiance per
/// direction from `p` and rays for visibility (`tracer` absent: all visible).
pub fn quadrature(
    q: &Quad,
    p: Vec3,
    n: Vec3,
    steps: usize,
    tracer: Option<&dyn Tracer>,
    radiance: impl Fn(Vec3) -> Vec3,
) -> DVec3 {
    let area = f64::from(q.edge_u.cross(q.edge_v).length()) / (steps * steps) as f64;
    let mut rays = Vec::new();
    let mut values = Vec::new();
    for i in 0..steps * steps {
        let at = |k: usize| (k as f32 + 0.5) / steps as f32;
        let d = (q.at(at(i % steps), at(i / steps)) - p).as_dvec3();
        let (r2, unit) = (d.length_squared(), d.normalize());
        let cosines = n.as_dvec3().dot(unit).max(0.0) * (-q.normal().as_dvec3().dot(unit)).max(0.0);
        values.push(radiance(unit.as_vec3()).as_dvec3() * (cosines * area / r2));
        rays.push(unbake::core::trace::Ray::new(
            p + n * 1e-5,
            unit.as_vec3(),
            r2.sqrt() as f32 * 0.999,
        ));
    }
    let mut hidden = vec![0u8; rays.len()];
    if let Some(t) = tracer {
        t.occluded(&rays, &mut hidden);
    }
    values
        .iter()
        .zip(&hidden)
        .filter(|(_, h)| **h == 0)
        .map(|(v, _)| *v)
        .sum()
}
