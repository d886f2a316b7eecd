//! How things end, as exceptions.

use foveal_engine::Failure;
use pyo3::PyErr;
use pyo3::exceptions::{PyException, PyFileNotFoundError, PyKeyboardInterrupt, PyValueError};

pyo3::create_exception!(
    _foveal,
    Error,
    PyException,
    "What the program would say and end with: a file that cannot be used, a limit that cannot be met, a replay that diverges."
);

/// A failure as an exception: what makes no sense is a `ValueError`, Ctrl-C a `KeyboardInterrupt`, all else an `Error`.
pub fn raised(failure: Failure) -> PyErr {
    let message = failure.to_string();
    match failure {
        Failure::Usage(_) => PyValueError::new_err(message),
        Failure::Interrupted(_) => PyKeyboardInterrupt::new_err(message),
        Failure::Check(_) | Failure::Input(_) | Failure::Limit(_) | Failure::Environment(_) => {
            Error::new_err(message)
        }
    }
}

/// A file to read, which is there.
pub fn existing(path: &std::path::Path) -> Result<(), PyErr> {
    match path.exists() {
        true => Ok(()),
        false => Err(PyFileNotFoundError::new_err(format!("{}: there is no such file", path.display()))),
    }
}
