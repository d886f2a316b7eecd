//! Pictures between here and numpy.

use foveal::image::{Map2d, linear_from_srgb};
use foveal_engine::Failure;
use foveal_engine::files::read_picture;
use glam::Vec3;
use numpy::ndarray::{Array2, Array3};
use numpy::{
    Element, IntoPyArray, PyArray2, PyArray3, PyReadonlyArray3, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// A map as an array of rows and columns.
pub fn array2<'py, T: Element>(
    py: Python<'py>,
    width: usize,
    height: usize,
    values: Vec<T>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let wrong = |e| PyValueError::new_err(format!("a map of {width} × {height} values: {e}"));
    Ok(Array2::from_shape_vec((height, width), values).map_err(wrong)?.into_pyarray(py))
}

/// A map of three values a pixel as an array of rows, columns and bands.
pub fn array3<'py, T: Element>(
    py: Python<'py>,
    width: usize,
    height: usize,
    values: Vec<T>,
) -> PyResult<Bound<'py, PyArray3<T>>> {
    let wrong = |e| PyValueError::new_err(format!("a picture of {width} × {height} pixels: {e}"));
    Ok(Array3::from_shape_vec((height, width, 3), values).map_err(wrong)?.into_pyarray(py))
}

/// Radiance as an array.
pub fn radiance<'py>(py: Python<'py>, picture: &Map2d<Vec3>) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let values = picture.data().iter().flat_map(|c| c.to_array()).collect();
    array3(py, picture.width(), picture.height(), values)
}

/// A picture that somebody gave: an array of bytes (sRGB) or floats (linear), or a file.
pub enum Given {
    File(std::path::PathBuf),
    Picture(Map2d<Vec3>),
}

impl Given {
    /// From what Python handed over.
    pub fn new(value: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(bytes) = value.extract::<PyReadonlyArray3<'_, u8>>() {
            let linear = |b: u8| linear_from_srgb(f32::from(b) / 255.0);
            return picture(&bytes, linear);
        }
        if let Ok(floats) = value.extract::<PyReadonlyArray3<'_, f32>>() {
            return picture(&floats, |v| v);
        }
        if let Ok(array) = value.cast::<PyUntypedArray>() {
            return Err(PyTypeError::new_err(format!(
                "a picture is an array of rows, columns and 3 bands, of uint8 (sRGB) or float32 (linear); this is {:?} of {}",
                array.shape(),
                array.dtype()
            )));
        }
        Ok(Self::File(value.extract()?))
    }

    /// The picture in linear RGB.
    pub fn read(self) -> Result<Map2d<Vec3>, Failure> {
        match self {
            Self::File(path) => read_picture(&path),
            Self::Picture(picture) => Ok(picture),
        }
    }
}

fn picture<T: Element + Copy>(array: &PyReadonlyArray3<'_, T>, linear: impl Fn(T) -> f32) -> PyResult<Given> {
    let view = array.as_array();
    let (height, width, bands) = view.dim();
    if bands != 3 || width == 0 || height == 0 {
        return Err(PyValueError::new_err(format!(
            "a picture has rows, columns and 3 bands; this array is {height} × {width} × {bands}"
        )));
    }
    let at = |x, y, band| linear(view[[y, x, band]]);
    Ok(Given::Picture(Map2d::from_fn(width, height, |x, y| Vec3::new(at(x, y, 0), at(x, y, 1), at(x, y, 2)))))
}

/// Columns and rows, within what the program takes.
pub fn size((width, height): (u32, u32)) -> PyResult<[u32; 2]> {
    let side = 1..=16384;
    if !side.contains(&width) || !side.contains(&height) || u64::from(width) * u64::from(height) > 1 << 26 {
        return Err(PyValueError::new_err(format!(
            "{width} × {height}: each side 1 to 16384, at most 64 Mi pixels"
        )));
    }
    Ok([width, height])
}
