//! Tables of received powers: files and data frames.

use crate::border::{input_error, log_message, reject, without_gil};
use pwrfgs::data::{ColumnChoice, TableFile, TableImport};
use pwrfgs_core::Dataset as Data;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Reads a table, or several, with the options of `Dataset.from_table`; None is as no option.
pub(super) fn read(table: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Data> {
    let mut import = TableImport { files: read_files(table)?, title: "table".into(), ..TableImport::default() };
    let mut accepted = Vec::new();
    for (key, value) in options.into_iter().flatten() {
        if !value.is_none() {
            let key: String = key.extract()?;
            match &*key {
                "accept" => {
                    accepted = list_items(&value)?.iter().map(PyAnyMethods::extract).collect::<PyResult<_>>()?;
                }
                key => set_option(&mut import, key, &value)?,
            }
        }
    }
    let imported = without_gil(table.py(), || import.read(&|_, _| {}))?;
    imported.notes.iter().for_each(|note| log_message("info", note));
    Ok(Data { accepted, ..imported.data })
}

/// Sets the option `key` of `import`. Raises an exception for an unknown one, or an invalid value.
fn set_option(import: &mut TableImport, key: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let ColumnChoice { x, y, z, lat, lon, floor, tx_id, receiver, power, time, wide } = &mut import.columns;
    // Names of columns are texts or, as pandas has them, numbers.
    let name = || name_text(value).map(Some);
    let file = || read_file(value).map(Some);
    match key {
        "x" => *x = name()?,
        "y" => *y = name()?,
        "z" => *z = name()?,
        "lat" => *lat = name()?,
        "lon" => *lon = name()?,
        "floor" => *floor = name()?,
        "tx_id" => *tx_id = name()?,
        "receiver" => *receiver = name()?,
        "power" => *power = name()?,
        "time" => *time = name()?,
        "columns" => *wide = list_items(value)?.iter().map(name_text).collect::<PyResult<_>>()?,
        "tx" => import.tx = file()?,
        "places" => import.places = file()?,
        "receivers" => import.receivers = file()?,
        "test" => import.test = read_files(value)?,
        "missing" => import.missing = list_items(value)?.iter().map(PyAnyMethods::extract).collect::<PyResult<_>>()?,
        "unit" => {
            let unit: String = value.extract()?;
            import.unit = unit.parse().map_err(|fault: String| input_error(value.py(), &format!("unit={fault}")))?;
        }
        "lat_lon" => import.is_lat_lon = value.extract()?,
        "height" => import.height = value.extract()?,
        "floor_height" => import.floor_height = value.extract()?,
        "title" => import.title = value.extract()?,
        "simulated" => import.is_simulated = value.extract()?,
        _ => {
            return reject(
                value.py(),
                &format!("from_table has no option `{key}`; help(pwrfgs.Dataset.from_table) lists them"),
            );
        }
    }
    Ok(())
}

/// Returns the name of a column as text.
fn name_text(value: &Bound<'_, PyAny>) -> PyResult<String> {
    value.str().map(|name| name.to_string())
}

/// Returns the items of a list or tuple, or the only item.
fn list_items<'py>(value: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let is_list = value.is_instance_of::<pyo3::types::PyList>() || value.is_instance_of::<pyo3::types::PyTuple>();
    if is_list { value.try_iter()?.collect() } else { Ok(vec![value.clone()]) }
}

/// Reads one table, or a list of tables.
fn read_files(value: &Bound<'_, PyAny>) -> PyResult<Vec<TableFile>> {
    list_items(value)?.iter().map(read_file).collect()
}

/// Reads a path, or a data frame as CSV.
fn read_file(value: &Bound<'_, PyAny>) -> PyResult<TableFile> {
    if let Ok(path) = value.extract::<PathBuf>() {
        return Ok(path.into_os_string().into());
    }
    if !value.hasattr("to_csv")? {
        return reject(value.py(), "a table is the path of a file, or a pandas DataFrame");
    }
    let keywords = PyDict::new(value.py());
    keywords.set_item("index", false)?;
    let text: String = value.call_method("to_csv", (), Some(&keywords))?.extract()?;
    Ok(TableFile { path: "data frame".into(), bytes: Some(text.into_bytes()) })
}
