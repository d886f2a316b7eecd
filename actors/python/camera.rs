//! Cameras and paths.

use foveal::scene::{Camera as SceneCamera, CameraPath};
use glam::Vec3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A pinhole camera.
#[pyclass(frozen, eq, module = "foveal", from_py_object)]
#[derive(Clone, Copy, PartialEq)]
pub struct Camera(pub SceneCamera);

/// Three numbers.
type Three = (f32, f32, f32);

fn checked(camera: SceneCamera) -> PyResult<Camera> {
    let view = camera.target - camera.eye;
    let wrong = |what: &str| Err(PyValueError::new_err(format!("{what}: {camera:?}")));
    if ![camera.eye, camera.target, camera.up].iter().all(|v| v.is_finite()) {
        return wrong("a camera's numbers must be finite");
    }
    if !(view.length_squared() > 0.0 && view.cross(camera.up).length_squared() > 0.0) {
        return wrong("a camera looks from `eye` to another point, not along `up`");
    }
    if !(camera.fov_y > 0.0 && camera.fov_y < std::f32::consts::PI) {
        return wrong("the field of view must be above 0 and below 180 degrees");
    }
    Ok(Camera(camera))
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (eye, target, up = (0.0, 1.0, 0.0), fov_y = 60.0))]
    fn new(eye: Three, target: Three, up: Three, fov_y: f32) -> PyResult<Self> {
        let [eye, target, up] = [eye, target, up].map(Vec3::from);
        checked(SceneCamera { eye, target, up, fov_y: fov_y.to_radians() })
    }

    #[getter]
    fn eye(&self) -> Three {
        self.0.eye.into()
    }

    #[getter]
    fn target(&self) -> Three {
        self.0.target.into()
    }

    #[getter]
    fn up(&self) -> Three {
        self.0.up.into()
    }

    #[getter]
    fn fov_y(&self) -> f32 {
        self.0.fov_y.to_degrees()
    }

    #[pyo3(signature = (right = 0.0, up = 0.0, forward = 0.0))]
    fn moved(&self, right: f32, up: f32, forward: f32) -> PyResult<Self> {
        let ahead = (self.0.target - self.0.eye).normalize();
        let aside = ahead.cross(self.0.up).normalize();
        let by = right * aside + up * aside.cross(ahead) + forward * ahead;
        checked(SceneCamera { eye: self.0.eye + by, target: self.0.target + by, ..self.0 })
    }

    fn __repr__(&self) -> String {
        let three = |v: Vec3| format!("({}, {}, {})", v.x, v.y, v.z);
        let SceneCamera { eye, target, up, fov_y } = self.0;
        let [eye, target, up] = [eye, target, up].map(three);
        format!("Camera(eye={eye}, target={target}, up={up}, fov_y={})", fov_y.to_degrees())
    }
}

/// A path that a camera goes along.
#[pyclass(frozen, module = "foveal", skip_from_py_object)]
#[derive(Clone)]
pub struct Path {
    pub path: CameraPath,
    /// Its up and field of view are those of the path.
    pub like: SceneCamera,
}

#[pymethods]
impl Path {
    #[getter]
    fn name(&self) -> &str {
        &self.path.name
    }

    #[getter]
    fn duration(&self) -> f32 {
        self.path.duration()
    }

    fn at(&self, seconds: f32) -> PyResult<Camera> {
        if !seconds.is_finite() {
            return Err(PyValueError::new_err("a path has no camera at a time that is no number"));
        }
        checked(self.path.at(seconds, self.like.up, self.like.fov_y))
    }

    fn __repr__(&self) -> String {
        format!("<foveal.Path {:?}, {} s>", self.path.name, self.path.duration())
    }
}
