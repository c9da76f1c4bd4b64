//! What every writer of a data folder writes alike.

use pwrfgs_core::Pose;

/// The text of `gateway_info.yml` for a data set called `name`.
pub fn gateway_yaml(name: &str, pose: &Pose) -> String {
    format!(
        "dataset_name: {}\ngateway1:\n  position: [{}]\n  orientation: [{}] # quaternion x, y, z, w\n",
        serde_json::Value::from(name), // a JSON string is a YAML string
        list(&pose.position),
        list(&pose.orientation)
    )
}

/// The text of `gateway_position.yml`: names and places of gateways, metres.
pub fn gateway_positions_yaml<'a>(gateways: impl IntoIterator<Item = (&'a str, [f64; 3])>) -> String {
    let line = |(name, place): (&str, [f64; 3])| format!("{}: [{}]\n", serde_json::Value::from(name), list(&place));
    gateways.into_iter().map(line).collect()
}

/// The text of `base-station.yml`: places of the antennas, metres.
pub fn base_station_yaml(antennas: &[[f64; 3]]) -> String {
    let places: Vec<String> = antennas.iter().map(|place| format!("[{}]", list(place))).collect();
    format!("base_station: [{}]\n", places.join(", "))
}

fn list(v: &[f64]) -> String {
    v.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(", ")
}
