//! Cameras in the coordinates of a scene's file.

use crate::said::{Raised, usage};
use glam::{DVec3, Mat3, Vec3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use unbake::core::geometry::Lens;
use unbake::render::{FrameOptions, NamedCamera};
use unbake::{Camera as Posed, Projection};

/// Largest side of an image, as of the program's frames.
const MOST_PIXELS: usize = 16_384;

/// How far the columns of a rotation may be from unit vectors at right angles. Derived: matrices
/// written with four decimals are exact to 1e-4.
const ROTATION_ERROR: f32 = 1e-3;

/// A posed camera: a panorama, or a pinhole camera. Values do not change.
#[pyclass(frozen)]
pub(crate) struct Camera {
    name: String,
    /// Its centre in the coordinates of the scene's file; `posed` stands at 0.
    position: DVec3,
    posed: Posed,
}

/// What a camera's image is like.
struct Image {
    width: usize,
    height: usize,
    /// Horizontal angle of view in degrees; a panorama without one.
    fov: Option<f32>,
}

impl Image {
    fn projection(&self, py: Python<'_>) -> PyResult<Projection> {
        let sizes = 1..=MOST_PIXELS;
        if !sizes.contains(&self.width) || !sizes.contains(&self.height) {
            let message = format!(
                "Camera: width={}, height={}: expected 1 to {MOST_PIXELS} pixels",
                self.width, self.height
            );
            return Err(usage(py, message));
        }
        match self.fov {
            None => Ok(Projection::Equirectangular),
            Some(fov) if (1.0..=170.0).contains(&fov) => Ok(Projection::Pinhole(Lens::centred(
                self.width,
                self.height,
                fov,
            ))),
            Some(fov) => Err(usage(
                py,
                format!("Camera: fov={fov}: expected 1 to 170 degrees, or None for a panorama"),
            )),
        }
    }
}

impl Camera {
    /// A camera of the library, whose position is relative to `origin`.
    pub(crate) fn of(camera: NamedCamera, origin: DVec3) -> Self {
        Self {
            name: camera.name,
            position: origin + camera.camera.position.as_dvec3(),
            posed: Posed {
                position: Vec3::ZERO,
                ..camera.camera
            },
        }
    }

    /// The camera relative to `origin`.
    fn from(&self, origin: DVec3) -> NamedCamera {
        NamedCamera {
            name: self.name.clone(),
            camera: Posed {
                position: (self.position - origin).as_vec3(),
                ..self.posed
            },
        }
    }

    fn new(
        py: Python<'_>,
        name: &str,
        position: [f64; 3],
        world_from_camera: Mat3,
        image: &Image,
    ) -> PyResult<Self> {
        let position = DVec3::from_array(position);
        let off = world_from_camera.transpose() * world_from_camera - Mat3::IDENTITY;
        let off = off
            .to_cols_array()
            .iter()
            .fold(0.0f32, |m, v| m.max(v.abs()));
        let right_handed = world_from_camera.determinant() > 0.0;
        if !(position.is_finite() && off <= ROTATION_ERROR && right_handed) {
            return Err(usage(
                py,
                "Camera: expected a finite position and a rotation whose columns are the camera's \
                 right, up and backward axes",
            ));
        }
        Ok(Self {
            name: name.to_owned(),
            position,
            posed: Posed {
                projection: image.projection(py)?,
                width: image.width,
                height: image.height,
                world_from_camera,
                position: Vec3::ZERO,
            },
        })
    }
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (position, world_from_camera, width, height, *, fov=None, name="camera"))]
    fn make(
        py: Python<'_>,
        position: [f64; 3],
        world_from_camera: [[f32; 3]; 3],
        width: usize,
        height: usize,
        fov: Option<f32>,
        name: &str,
    ) -> PyResult<Self> {
        // rows, as numpy prints a matrix
        let rotation = Mat3::from_cols_array_2d(&world_from_camera).transpose();
        Self::new(py, name, position, rotation, &Image { width, height, fov })
    }

    /// A camera at `position` that looks at `target`, +y up in its image. Raises UsageError as the constructor does.
    #[staticmethod]
    #[pyo3(signature = (position, target, width, height, *, fov=None, name="camera"))]
    fn look_at(
        py: Python<'_>,
        position: [f64; 3],
        target: [f64; 3],
        width: usize,
        height: usize,
        fov: Option<f32>,
        name: &str,
    ) -> PyResult<Self> {
        let sight = (DVec3::from_array(position) - DVec3::from_array(target)).as_vec3();
        let back = sight.normalize_or_zero();
        // straight up or down, the image's top is where +z is
        let up = match back.y.abs() < 0.9999 {
            true => Vec3::Y,
            false => Vec3::Z,
        };
        let right = up.cross(back).normalize_or_zero();
        let rotation = Mat3::from_cols(right, back.cross(right), back);
        Self::new(py, name, position, rotation, &Image { width, height, fov })
    }

    /// The name of what is made of it: of a scene's camera, its image without the ending.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }
    /// Pixels.
    #[getter]
    fn width(&self) -> usize {
        self.posed.width
    }
    /// Pixels.
    #[getter]
    fn height(&self) -> usize {
        self.posed.height
    }
    /// Whether it sees all directions.
    #[getter]
    fn panorama(&self) -> bool {
        self.posed.projection == Projection::Equirectangular
    }
    /// Metres, coordinates of the scene's file.
    #[getter]
    fn position(&self) -> (f64, f64, f64) {
        self.position.into()
    }
    /// Rows of the rotation.
    #[getter]
    fn world_from_camera(&self) -> [[f32; 3]; 3] {
        self.posed.world_from_camera.transpose().to_cols_array_2d()
    }
    /// None of a panorama.
    #[getter]
    fn lens<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Projection::Pinhole(lens) = self.posed.projection else {
            return Ok(None);
        };
        let dict = PyDict::new(py);
        let [k1, k2] = lens.k;
        let [p1, p2] = lens.p;
        let values = [
            ("fl_x", lens.fl_x),
            ("fl_y", lens.fl_y),
            ("cx", lens.cx),
            ("cy", lens.cy),
            ("k1", k1),
            ("k2", k2),
            ("p1", p1),
            ("p2", p2),
        ];
        for (name, value) in values {
            dict.set_item(name, value)?;
        }
        Ok(Some(dict))
    }

    fn __repr__(&self) -> String {
        let kind = if self.panorama() {
            "panorama"
        } else {
            "pinhole"
        };
        format!(
            "<unbake.Camera {:?}: {kind} {}x{} at {}>",
            self.name, self.posed.width, self.posed.height, self.position
        )
    }
}

/// One camera or several.
#[derive(FromPyObject)]
pub(crate) enum Cameras {
    One(Py<Camera>),
    Many(Vec<Py<Camera>>),
}

impl Cameras {
    /// What the frames are to be rendered from, relative to `origin`.
    pub(crate) fn frames(
        &self,
        py: Python<'_>,
        options: &FrameOptions,
        origin: DVec3,
    ) -> PyResult<Vec<NamedCamera>> {
        let given = match self {
            Self::One(camera) => vec![camera.get().from(origin)],
            Self::Many(list) => list.iter().map(|c| c.get().from(origin)).collect(),
        };
        options.frames(given).raised(py)
    }

    /// Whether one picture is expected, and not a list.
    pub(crate) fn is_one(&self) -> bool {
        matches!(self, Self::One(_))
    }
}
