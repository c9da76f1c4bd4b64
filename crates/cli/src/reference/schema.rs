//! The JSON schema of pipeline and experiment files, for editors and programs that write such files.

use pwrfgs::experiment::sweep::Experiment;
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::schemars::{self, JsonSchema, schema_for};
use serde_json::Value;

/// A file of pwrfgs: `Name(field: value)` in RON is `{"Name": {"field": value}}` here.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "its schema alone is of use")]
enum File {
    /// A run, as `pwrfgs run` reads it.
    Pipeline(Box<Pipeline>),
    /// A sweep, as `pwrfgs sweep` reads it.
    Experiment(Box<Experiment>),
}

/// The schema as text.
pub(crate) fn text() -> String {
    let mut schema = schema_for!(File).to_value();
    shorten(&mut schema);
    format!("{schema:#}\n")
}

/// Writes defaults in single precision with the digits of single precision.
fn shorten(value: &mut Value) {
    match value {
        Value::Number(number) if number.is_f64() => {
            let exact = number.as_f64().unwrap_or_default();
            let short = (exact as f32).to_string().parse::<f64>();
            if let (true, Ok(short)) = (f64::from(exact as f32) == exact, short) {
                *value = short.into();
            }
        }
        Value::Array(items) => items.iter_mut().for_each(shorten),
        Value::Object(fields) => fields.values_mut().for_each(shorten),
        _ => {}
    }
}
