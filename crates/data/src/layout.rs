//! What every writer of a data folder writes alike.

use pwrfgs_core::{Origin, Pose, Receiver};

/// The text of `gateway_info.yml` for a data set called `name`.
pub fn gateway_yaml(name: &str, pose: &Pose) -> String {
    format!(
        "dataset_name: {}\ngateway1:\n  position: [{}]\n  orientation: [{}] # quaternion x, y, z, w\n",
        yaml(name),
        list(&pose.position),
        list(&pose.orientation)
    )
}

/// The text of `gateway_position.yml`: names and places of gateways, metres, with the orientation of those that are turned.
pub fn gateway_positions_yaml<'a>(gateways: impl IntoIterator<Item = (&'a str, Pose)>) -> String {
    let line = |(name, pose): (&str, Pose)| {
        let (name, place) = (yaml(name), list(&pose.position));
        if pose.orientation == Pose::IDENTITY.orientation {
            return format!("{name}: [{place}]\n");
        }
        format!("{name}: {{position: [{place}], orientation: [{}]}}\n", list(&pose.orientation))
    };
    gateways.into_iter().map(line).collect()
}

/// A text of YAML: a JSON string is one, but for some signs that are written as numbers.
pub(crate) fn yaml(text: &str) -> String {
    let is_number = |c: char| c.is_control() || "\u{2028}\u{2029}\u{feff}\u{fffe}\u{ffff}".contains(c);
    let write = |c: char| if is_number(c) { format!("\\u{:04x}", u32::from(c)) } else { c.into() };
    serde_json::Value::from(text).to_string().chars().map(write).collect()
}

/// The text of `base-station.yml`: places of the antennas, metres.
pub fn base_station_yaml(antennas: &[[f64; 3]]) -> String {
    let places: Vec<String> = antennas.iter().map(|place| format!("[{}]", list(place))).collect();
    format!("base_station: [{}]\n", places.join(", "))
}

/// The text of `receiver.yml`: pose, frequencies, and places of the antennas in the world; metres and Hz.
pub(crate) fn receiver_yaml(receiver: &Receiver, origin: Origin, frequencies_hz: &[f64]) -> String {
    let [first, last] = [frequencies_hz[0], frequencies_hz[frequencies_hz.len() - 1]];
    let carrier_hz = 0.5 * (first + last);
    let spacing_hz = (last - first) / (frequencies_hz.len() - 1).max(1) as f64;
    let pose = origin.world_pose(receiver.pose);
    let antenna = |about: [f64; 3]| format!("[{}]", list(&[0, 1, 2].map(|k| pose.position[k] + about[k])));
    format!(
        "name: {}\nposition: [{}]\norientation: [{}] # quaternion x, y, z, w\ncarrier_hz: {carrier_hz:?}\n\
         spacing_hz: {spacing_hz:?}\nfrequencies_hz: [{}]\nantennas: [{}] # in the world, metres\n",
        yaml(&receiver.name),
        list(&pose.position),
        list(&pose.orientation),
        list(frequencies_hz),
        receiver.array().into_iter().map(antenna).collect::<Vec<_>>().join(", ")
    )
}

fn list(v: &[f64]) -> String {
    v.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(", ")
}
