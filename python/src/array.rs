//! Arrays in and out. Entry points: [`vector`], [`matrix`], [`give`].

use numpy::{
    AllowTypeChange, Element, PyArray1, PyArrayDyn, PyArrayLike1, PyArrayLikeDyn, PyArrayMethods,
    PyUntypedArrayMethods, dtype,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// `N` finite numbers of an argument called `name`, from an array or any sequence.
///
/// # Errors
/// TypeError or ValueError that name the argument and what it is.
pub fn vector<const N: usize>(name: &str, given: &Bound<'_, PyAny>) -> PyResult<[f64; N]> {
    let array: PyArrayLike1<'_, f64, AllowTypeChange> = given.extract().map_err(|_| {
        let kind = given.get_type();
        PyTypeError::new_err(format!(
            "{name} is of {kind}: give {N} numbers, as an array, a list or a tuple"
        ))
    })?;
    let mut numbers = [0.0; N];
    let view = array.as_array();
    if view.len() != N {
        let count = view.len();
        return Err(PyValueError::new_err(format!(
            "{name} has {count} numbers: give {N}"
        )));
    }
    for (index, (to, from)) in numbers.iter_mut().zip(view).enumerate() {
        if !from.is_finite() {
            return Err(PyValueError::new_err(format!(
                "{name}[{index}] is {from}: give finite numbers"
            )));
        }
        *to = *from;
    }
    Ok(numbers)
}

/// A 3 x 3 matrix of finite numbers of an argument called `name`, row by row.
///
/// # Errors
/// As [`vector`].
pub fn matrix(name: &str, given: &Bound<'_, PyAny>) -> PyResult<[[f64; 3]; 3]> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = given.extract().map_err(|_| {
        let kind = given.get_type();
        PyTypeError::new_err(format!("{name} is of {kind}: give 3 rows of 3 numbers"))
    })?;
    let view = array.as_array();
    if view.shape() != [3, 3] {
        let shape = of(view.shape());
        return Err(PyValueError::new_err(format!(
            "{name} has the shape {shape}: give (3, 3)"
        )));
    }
    let mut rows = [[0.0; 3]; 3];
    for (index, (to, from)) in rows.as_flattened_mut().iter_mut().zip(view).enumerate() {
        if !from.is_finite() {
            let (row, column) = (index / 3, index % 3);
            return Err(PyValueError::new_err(format!(
                "{name}[{row}, {column}] is {from}: give finite numbers"
            )));
        }
        *to = *from;
    }
    Ok(rows)
}

/// Numbers row by row as an array of this shape: a fresh one, or `out`.
///
/// # Errors
/// TypeError or ValueError for an `out` of another kind, shape or order, or one that is read-only.
pub fn give<'py, T: Element + Copy>(
    py: Python<'py>,
    numbers: &[T],
    shape: &[usize],
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let Some(out) = out else {
        let flat = PyArray1::from_slice(py, numbers);
        return Ok(flat.reshape(shape.to_vec())?.into_any());
    };
    let wanted = || {
        format!(
            "give a C-contiguous array of {} with the shape {}",
            dtype::<T>(py),
            of(shape)
        )
    };
    let array = out.cast::<PyArrayDyn<T>>().map_err(|_| {
        let kind = out
            .getattr("dtype")
            .unwrap_or_else(|_| out.get_type().into_any());
        PyTypeError::new_err(format!("out is of {kind}: {}", wanted()))
    })?;
    if array.shape() != shape {
        let message = format!("out has the shape {}: {}", of(array.shape()), wanted());
        return Err(PyValueError::new_err(message));
    }
    if !array.is_c_contiguous() {
        return Err(PyValueError::new_err(format!(
            "out is not contiguous: {}",
            wanted()
        )));
    }
    let mut room = array.try_readwrite().map_err(|error| {
        PyValueError::new_err(format!("out cannot be written ({error}): {}", wanted()))
    })?;
    room.as_slice_mut()?.copy_from_slice(numbers);
    Ok(out.clone())
}

/// A shape as Python writes it.
fn of(shape: &[usize]) -> String {
    match shape {
        [length] => format!("({length},)"),
        lengths => {
            let lengths: Vec<_> = lengths.iter().map(usize::to_string).collect();
            format!("({})", lengths.join(", "))
        }
    }
}
