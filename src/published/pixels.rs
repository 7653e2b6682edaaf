//! What the published method trains on: the first hits of every view at its resolution, with the
//! photographs' radiance there (method §5, §14). Panoramas become the six faces of a cube.

use crate::core::geometry::{Camera, Lens, Projection};
use crate::core::image::Plane;
use crate::core::parallel::prelude::*;
use crate::gbuffer::{ObservedView, ViewBuffer};
use crate::observed::Surface;
use glam::{Mat3, Vec2, Vec3};

/// A pixel that sees the mesh.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Place on the surface, metres.
    pub position: Vec3,
    /// Shading normal there, on the side the cameras see.
    pub normal: Vec3,
    /// Unit direction to the camera.
    pub to_camera: Vec3,
    /// Place on the atlas.
    pub uv: Vec2,
    /// Side of the pixel's footprint in widths of the atlas.
    pub footprint: f32,
    /// What the photograph shows.
    pub radiance: Vec3,
    /// |∇I| of the photograph, of ln(1 + I) from pixel to pixel in the units of the losses
    /// ([`PixelGrid::find_contrasts`]).
    pub contrast: f32,
    /// Class; 0 is unlabelled.
    pub class: u16,
    /// Room.
    pub room: u16,
    /// Place in the view's grid, row-major, face after face.
    pub cell: u32,
}

/// The pixels of one view.
#[derive(Clone, Debug, Default)]
pub struct PixelGrid {
    /// Those that see the mesh.
    pub pixels: Vec<Pixel>,
    /// Columns of a face.
    pub width: usize,
    /// Rows of a face.
    pub height: usize,
    /// Faces.
    pub faces: usize,
}

impl PixelGrid {
    /// Pixels in all, those without geometry included: what means are taken over.
    #[must_use]
    pub fn size(&self) -> usize {
        self.width * self.height * self.faces
    }

    /// Writes the contrast of every pixel to its neighbours on the right and below.
    pub fn find_contrasts(&mut self) {
        let mut brightness = vec![f32::NAN; self.size()];
        let of = |p: &Pixel| {
            let ln = p.radiance.max(Vec3::ZERO).to_array().map(f32::ln_1p);
            ln.iter().sum::<f32>() / 3.0
        };
        for p in &self.pixels {
            brightness[p.cell as usize] = of(p);
        }
        let (width, height) = (self.width, self.height);
        for p in &mut self.pixels {
            let cell = p.cell as usize;
            let (x, y) = (cell % width, cell / width % height);
            let to = |there: bool, step: usize| {
                let off = if there {
                    brightness[cell + step] - brightness[cell]
                } else {
                    0.0
                };
                if off.is_nan() { 0.0 } else { off }
            };
            p.contrast = to(x + 1 < width, 1).hypot(to(y + 1 < height, width));
        }
    }
}

/// Orientations of a cube's faces against the camera: columns are right, up and backward.
fn faces() -> [Mat3; 6] {
    let of = |right: Vec3, up: Vec3| Mat3::from_cols(right, up, right.cross(up));
    [
        of(Vec3::X, Vec3::Y),
        of(Vec3::NEG_X, Vec3::Y),
        of(Vec3::Z, Vec3::Y),
        of(Vec3::NEG_Z, Vec3::Y),
        of(Vec3::X, Vec3::Z),
        of(Vec3::X, Vec3::NEG_Z),
    ]
}

/// The cameras that stand for a view at the training resolution: six faces of 90°, or the view's
/// own frame reduced to as many pixels; `side` pixels along a face.
fn cameras(camera: &Camera, side: usize) -> Vec<Camera> {
    match camera.projection {
        Projection::Equirectangular => faces()
            .into_iter()
            .map(|face| Camera {
                projection: Projection::Pinhole(Lens::centred(side, side, 90.0)),
                width: side,
                height: side,
                world_from_camera: camera.world_from_camera * face,
                position: camera.position,
            })
            .collect(),
        Projection::Pinhole(_) => {
            let pixels = (camera.width * camera.height) as f32;
            let scale = ((6 * side * side) as f32 / pixels).sqrt().min(1.0);
            let reduced = |n: usize| ((n as f32 * scale).round() as usize).max(1);
            vec![camera.resized(reduced(camera.width), reduced(camera.height))]
        }
    }
}

/// The training pixels of every view, of cubes with `side` pixels along a face. `rooms` are ids on
/// the atlas.
#[must_use]
pub fn training_pixels(surface: &Surface, rooms: &Plane<u16>, side: usize) -> Vec<PixelGrid> {
    let labels = surface.texels.scatter(&surface.labels, 0);
    let reader = PixelReader {
        surface,
        rooms,
        labels: &labels,
    };
    surface
        .views
        .par_iter()
        .map(|view| reader.grid(view, side))
        .collect()
}

/// Reads pixels off a view.
struct PixelReader<'a> {
    surface: &'a Surface<'a>,
    rooms: &'a Plane<u16>,
    labels: &'a Plane<u16>,
}

impl PixelReader<'_> {
    fn grid(&self, view: &ObservedView, side: usize) -> PixelGrid {
        let cameras = cameras(&view.buffer.camera, side);
        let (width, height) = (cameras[0].width, cameras[0].height);
        let mut grid = PixelGrid {
            width,
            height,
            faces: cameras.len(),
            pixels: Vec::new(),
        };
        for (face, camera) in cameras.iter().enumerate() {
            let buffer = ViewBuffer::trace(camera, &self.surface.tracer);
            for cell in 0..width * height {
                let pixel = self.pixel(view, &buffer, cell);
                grid.pixels.extend(pixel.map(|p| Pixel {
                    cell: (face * width * height + cell) as u32,
                    ..p
                }));
            }
        }
        grid
    }

    /// The pixel at `cell` of a face; `None` where it sees no geometry or the photograph is masked.
    fn pixel(&self, view: &ObservedView, buffer: &ViewBuffer, cell: usize) -> Option<Pixel> {
        let t = buffer.distance.data[cell];
        if !t.is_finite() {
            return None;
        }
        let camera = &buffer.camera;
        let (x, y) = (cell % camera.width, cell / camera.width);
        let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        let direction = camera.direction(centre);
        let photo = &view.buffer.camera;
        let at = photo.project(photo.position + direction)?;
        let (column, row) = (
            (at.x as usize).min(photo.width - 1),
            (at.y as usize).min(photo.height - 1),
        );
        let place = row * photo.width + column;
        if view.valid.as_ref().is_some_and(|v| !v.data[place]) {
            return None;
        }
        let mesh = &self.surface.scene.mesh;
        let triangle = buffer.triangle.data[cell] as usize;
        let position = camera.position + direction * t;
        let (u, v) = mesh.barycentrics(triangle, position);
        let (normal, face_normal) = self.surface.normals(triangle, u, v);
        let uv = mesh.uv(triangle, u, v);
        let on_atlas = mesh.chart_area(triangle);
        let n_v = face_normal.dot(-direction).abs().max(0.02);
        let footprint = t * camera.pixel_angle(centre) / n_v.sqrt();
        let class = match &view.labels {
            Some(labels) => {
                let scale = Vec2::new(
                    labels.width as f32 / photo.width as f32,
                    labels.height as f32 / photo.height as f32,
                );
                *labels.nearest(at * scale)
            }
            None => *self.labels.nearest(uv * self.labels.width as f32),
        };
        Some(Pixel {
            position,
            normal,
            to_camera: -direction,
            uv,
            footprint: footprint * (on_atlas / mesh.area(triangle).max(f32::MIN_POSITIVE)).sqrt(),
            radiance: view.radiance.data[place],
            contrast: 0.0,
            class,
            room: *self.rooms.nearest(uv * self.rooms.width as f32),
            cell: 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contrast_is_that_to_the_right_and_below() {
        let pixel = |cell: u32| Pixel {
            position: Vec3::ZERO,
            normal: Vec3::Y,
            to_camera: Vec3::Y,
            uv: Vec2::ZERO,
            footprint: 0.0,
            radiance: Vec3::splat((0.5 * (cell % 3) as f32 + (cell / 3) as f32).exp_m1()),
            contrast: 0.0,
            class: 1,
            room: 1,
            cell,
        };
        let mut grid = PixelGrid {
            // one pixel sees no geometry
            pixels: (0..9).filter(|c| *c != 5).map(pixel).collect(),
            width: 3,
            height: 3,
            faces: 1,
        };
        grid.find_contrasts();
        let contrast = |cell: u32| {
            let found = grid.pixels.iter().find(|p| p.cell == cell);
            found.map(|p| p.contrast)
        };
        let close = |a: Option<f32>, b: f32| a.is_some_and(|a| (a - b).abs() < 1e-5);
        assert!(close(contrast(0), 1.25f32.sqrt()));
        assert!(close(contrast(4), 1.0), "nothing on the right");
        assert!(close(contrast(2), 0.0) && close(contrast(8), 0.0));
    }

    #[test]
    fn six_faces_look_along_all_axes_and_are_no_mirrors() {
        let mut seen = Vec3::ZERO;
        for face in faces() {
            assert!((face.determinant() - 1.0).abs() < 1e-6);
            seen += (face * Vec3::NEG_Z).abs();
        }
        assert_eq!(seen, Vec3::splat(2.0));
    }
}
