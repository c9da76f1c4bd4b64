//! What every writer of a data folder writes alike.

use pwrfgs_core::Pose;

/// The text of `gateway_info.yml` for a data set called `name`.
pub fn gateway_yaml(name: &str, pose: &Pose) -> String {
    let list = |v: &[f64]| v.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(", ");
    format!(
        "dataset_name: {}\ngateway1:\n  position: [{}]\n  orientation: [{}] # quaternion x, y, z, w\n",
        serde_json::Value::from(name), // a JSON string is a YAML string
        list(&pose.position),
        list(&pose.orientation)
    )
}
