//! What every writer of a data folder writes alike.

use pwrfgs_core::{Origin, Pose, Receiver};

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

/// The text of `receiver.yml`: pose, frequencies, and places of the antennas in the world; metres and Hz.
pub(crate) fn receiver_yaml(receiver: &Receiver, origin: Origin, carrier_hz: f64, spacing_hz: f64) -> String {
    let pose = origin.world_pose(receiver.pose);
    let antenna = |about: [f64; 3]| format!("[{}]", list(&[0, 1, 2].map(|k| pose.position[k] + about[k])));
    format!(
        "name: {}\nposition: [{}]\norientation: [{}] # quaternion x, y, z, w\ncarrier_hz: {carrier_hz:?}\n\
         spacing_hz: {spacing_hz:?}\nantennas: [{}] # in the world, metres\n",
        serde_json::Value::from(receiver.name.as_str()),
        list(&pose.position),
        list(&pose.orientation),
        receiver.array().into_iter().map(antenna).collect::<Vec<_>>().join(", ")
    )
}

fn list(v: &[f64]) -> String {
    v.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(", ")
}
