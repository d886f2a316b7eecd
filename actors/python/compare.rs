//! How far two pictures are apart.

use foveal::display::tone::{ToneCurve, ToneMap};
use foveal::metrics;
use foveal_engine::Failure;
use numpy::PyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::beside::wait_for;
use crate::pictures::{Given, array2};

/// How far two pictures are apart.
#[pyclass(frozen, module = "foveal")]
pub struct Comparison(metrics::Comparison);

#[pymethods]
impl Comparison {
    #[getter]
    fn flip(&self) -> f64 {
        self.0.flip
    }

    #[getter]
    fn flip_map<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let map = &self.0.flip_map;
        array2(py, map.width(), map.height(), map.data().to_vec())
    }

    #[getter]
    fn psnr(&self) -> Option<f64> {
        self.0.psnr
    }

    #[getter]
    fn mse(&self) -> f64 {
        self.0.mse
    }

    #[getter]
    fn relmse(&self) -> f64 {
        self.0.linear.relmse
    }

    #[getter]
    fn delta_e(&self) -> f64 {
        self.0.delta_e
    }

    #[getter]
    fn max_abs(&self) -> f64 {
        self.0.linear.max_abs
    }

    #[getter]
    fn identical(&self) -> bool {
        self.0.identical
    }

    fn __repr__(&self) -> String {
        let same = if self.0.identical { ", identical" } else { "" };
        format!("<foveal.Comparison FLIP {:.4}, relMSE {:.3e}{same}>", self.0.flip, self.0.linear.relmse)
    }
}

/// Compares two pictures.
#[pyfunction]
#[pyo3(signature = (test, reference, *, exposure = 1.0))]
pub fn compare(
    py: Python<'_>,
    test: &Bound<'_, PyAny>,
    reference: &Bound<'_, PyAny>,
    exposure: f32,
) -> PyResult<Comparison> {
    if !(exposure > 0.0 && exposure < 1e6) {
        return Err(PyValueError::new_err("exposure: a number above 0 and below 1000000 is needed"));
    }
    let (test, reference) = (Given::new(test)?, Given::new(reference)?);
    wait_for(py, move |_| {
        let tone = ToneMap { exposure, curve: ToneCurve::Clamp };
        let compared = metrics::compare(&test.read()?, &reference.read()?, &tone);
        compared.map(Comparison).map_err(|e| Failure::Usage(e.to_string()))
    })
}
