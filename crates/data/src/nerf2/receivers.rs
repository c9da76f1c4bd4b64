//! Receiver and antenna positions in YAML: `gateway_info.yml`, `gateway_position.yml` and `base-station.yml`.

use crate::checks::name_fault;
use crate::text::{read_yaml, yaml_fault};
use pwrfgs_core::position_fault;
use pwrfgs_core::{Elevation, Error, Pose, Receiver, Result, messages::strip_control};
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_saphyr::Spanned;
use std::collections::BTreeMap;
use std::path::Path;

const GATEWAY: &str = "expected `gateway1: {position: [x, y, z], orientation: [x, y, z, w]}` (metres; unit quaternion)";
const GATEWAYS: &str = "expected one gateway per line, such as `g01: [x, y, z]` (metres), or `g01: {position: [x, y, z], \
                        orientation: [x, y, z, w]}`";
const ANTENNAS: &str = "expected `base_station: [[x, y, z], ..]` (metres), one position per antenna";

/// Content of `gateway_info.yml`: name of the data set, position and orientation of the receiver.
#[derive(Debug, PartialEq)]
pub(crate) struct Gateway {
    /// Name of the data set, if given.
    pub(crate) name: Option<String>,
    pub(crate) pose: Pose,
    /// Name of the receiver, if given.
    receiver: Option<String>,
    /// Elevations of the image rows, if given.
    pub(crate) elevation: Option<Elevation>,
}

/// Value in `gateway_info.yml`.
#[derive(Deserialize)]
#[serde(untagged)]
enum GatewayValue {
    Pose(Pose),
    /// Gateway with an invalid pose.
    Gateway {
        #[serde(rename = "position")]
        _position: IgnoredAny,
    },
    Range(Elevation),
    Text(String),
    Number(f64),
    Other(IgnoredAny),
}

impl GatewayValue {
    /// Returns a text or a number as text; `None` for blank text and other values.
    fn text(&self) -> Option<String> {
        match self {
            Self::Text(text) => Some(text.clone()).filter(|text| !text.trim().is_empty()),
            Self::Number(number) => Some(number.to_string()),
            _ => None,
        }
    }
}

impl Gateway {
    /// Reads `gateway_info.yml`; `requested` is the gateway that the user selected, `None`: `gateway1`. `advice` is the next
    /// step if the file does not exist. Returns an error for a missing or ambiguous gateway, or an invalid value.
    pub(crate) fn read(path: &Path, requested: Option<&str>, advice: &str) -> Result<Self> {
        let file: BTreeMap<String, Spanned<GatewayValue>> = read_yaml(path, advice, GATEWAY)?;
        let name = requested.unwrap_or("gateway1");
        let is_other = |key: &str, value: &GatewayValue| {
            let has_position = matches!(value, GatewayValue::Pose(_) | GatewayValue::Gateway { .. });
            key != name && (has_position || key.to_lowercase().starts_with("gateway"))
        };
        let others = in_file_order(file.iter().filter(|(key, value)| is_other(key, &value.value)));
        let listed =
            others.iter().map(|(other, _)| format!("`{}`", strip_control(other))).collect::<Vec<_>>().join(", ");
        let Some(value) = file.get(name) else {
            let advice = others.first().map_or_else(String::new, |(first, _)| {
                format!("select {listed}: Nerf2Spectrum(gateway: \"{}\", ..), or else ", strip_control(first))
            });
            return Err(Error::at(path, 1, 1, format!("missing field `{}`; {advice}{GATEWAY}", strip_control(name))));
        };
        if let (None, Some((_, other))) = (requested, others.first()) {
            let problem = format!(
                "there are more receivers than one, `{name}` and {listed}, and `Nerf2Spectrum` reads one; name it: \
                 Nerf2Spectrum(gateway: \"{name}\", ..)"
            );
            return Err(yaml_fault(path, other, problem));
        }
        let GatewayValue::Pose(pose) = value.value else { return Err(yaml_fault(path, value, GATEWAY)) };
        if let Some((_, fault)) = pose.fault() {
            return Err(yaml_fault(path, value, fault));
        }
        let elevation = file.get("elevation").map(|value| parse_elevation(path, value)).transpose()?;
        let named = file.get("receiver").and_then(|value| Some((value, value.value.text()?)));
        if let Some((value, fault)) = named.as_ref().and_then(|(value, name)| Some((value, name_fault(name)?))) {
            return Err(yaml_fault(path, value, fault));
        }
        let title = file.get("dataset_name").and_then(|value| value.value.text());
        Ok(Self { name: title, pose, receiver: named.map(|(_, name)| name), elevation })
    }

    /// Creates the receiver, called `receiver` without a name in the file.
    pub(crate) fn create_receiver(&self) -> Receiver {
        Receiver::new(self.receiver.as_deref().unwrap_or("receiver"), self.pose)
    }
}

/// Parses the elevations of the image rows, degrees. Returns an error for another value or an invalid range.
fn parse_elevation(path: &Path, value: &Spanned<GatewayValue>) -> Result<Elevation> {
    let GatewayValue::Range(range) = value.value else {
        return Err(yaml_fault(path, value, "expected `elevation: [first, last]`, degrees"));
    };
    range.fault().map_or(Ok(range), |fault| Err(yaml_fault(path, value, fault)))
}

/// Returns the entries of a YAML mapping in the order of the file.
fn in_file_order<K, V: std::ops::Deref<Target = Spanned<T>>, T>(entries: impl Iterator<Item = (K, V)>) -> Vec<(K, V)> {
    let mut entries: Vec<(K, V)> = entries.collect();
    entries.sort_by_key(|(_, value)| (value.referenced.line(), value.referenced.column()));
    entries
}

/// Gateway in `gateway_position.yml`.
#[derive(Deserialize)]
#[serde(untagged, expecting = "neither a position nor a pose")]
enum GatewayPosition {
    Position([f64; 3]),
    Pose(Pose),
}

/// Reads the names and poses of the gateways in file order; without an orientation, the axes are those of the world frame.
/// `advice` is the next step if the file does not exist. Returns an error for no gateway, or an invalid one.
pub(super) fn read_gateways(path: &Path, advice: &str) -> Result<Vec<(String, Pose)>> {
    let file: BTreeMap<String, Spanned<GatewayPosition>> = read_yaml(path, advice, GATEWAYS)?;
    if file.is_empty() {
        return Err(Error::input(path, format!("names no gateway; {GATEWAYS}")));
    }
    let read = |(name, value): (&String, &Spanned<GatewayPosition>)| {
        let pose = match value.value {
            GatewayPosition::Position(position) => Pose { position, ..Pose::IDENTITY },
            GatewayPosition::Pose(pose) => pose,
        };
        let fault = position_fault(pose.position);
        let fault = fault.or_else(|| pose.fault().map(|(_, fault)| format!("has an invalid orientation: {fault}")));
        let fault = fault.map(|fault| format!("`{}` {fault}", strip_control(name)));
        name_fault(name).or(fault).map_or_else(|| Ok((name.clone(), pose)), |fault| Err(yaml_fault(path, value, fault)))
    };
    in_file_order(file.iter()).into_iter().map(read).collect()
}

/// Content of `base-station.yml`.
#[derive(Deserialize)]
struct BaseStation {
    base_station: Vec<Spanned<[f64; 3]>>,
}

/// Reads the antenna positions of a base station `[A,3]`, metres. `advice` is the next step if the file does not exist.
/// Returns an error for no antenna, or an invalid one.
pub(super) fn read_antennas(path: &Path, advice: &str) -> Result<Vec<[f64; 3]>> {
    let BaseStation { base_station } = read_yaml(path, advice, ANTENNAS)?;
    if base_station.is_empty() {
        return Err(Error::input(path, format!("names no antenna; {ANTENNAS}")));
    }
    let read = |(k, position): (usize, &Spanned<[f64; 3]>)| {
        let fault = |fault| Err(yaml_fault(path, position, format!("antenna {} {fault}", k + 1)));
        position_fault(position.value).map_or(Ok(position.value), fault)
    };
    base_station.iter().enumerate().map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_str(text: &str) -> Result<Gateway, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.yml");
        std::fs::write(&path, text).unwrap();
        Gateway::read(&path, None, "").map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
    }

    #[test]
    fn reads_released_gateway_file() {
        let text = "dataset_name: s23\ngateway1:\n  position: [5.0, 0.26, 0]\n  \
                    orientation: [0.51291602, -0.48674136, -0.48674136, 0.51291602]  # quaternion\n";
        let gateway = read_str(text).unwrap();
        assert_eq!(gateway.name.as_deref(), Some("s23"));
        assert_eq!(gateway.pose.position, [5.0, 0.26, 0.0]);
        assert_eq!(gateway.pose.orientation[1], -0.486_741_36);
        let crlf = read_str(&text.replace('\n', "\r\n")).unwrap();
        assert_eq!(crlf, gateway);
    }

    #[test]
    fn reports_position_of_invalid_input() {
        let file = |orientation: &str| format!("gateway1:\n  position: [0, 0, 0]\n  orientation: {orientation}\n");
        let cases = [
            (
                file("[0, 0, 0, 0]"),
                "DIR/g.yml:2:3: the quaternion is zero; write x, y, z, w of length 1, such as [0, 0, 0, 1] for no rotation",
            ),
            (
                file("[0, 0, 0, 1.002]"),
                "DIR/g.yml:2:3: the quaternion has length 1.002000, expected 1 within 0.001; divide x, y, z, w by it",
            ),
            (file("[0, .nan, 0, 1]"), "DIR/g.yml:3:20: value `.nan` is not a finite number; expected"),
            (
                "gateway1: {position: [.inf, 0, 0], orientation: [0, 0, 0, 1]}".into(),
                "DIR/g.yml:1:23: value `.inf` is not a finite number; expected",
            ),
        ];
        for (text, message) in cases {
            let error = read_str(&text).unwrap_err();
            assert!(error.starts_with(message), "{error}");
        }
        assert!(read_str(&file("[0, 0, 0, 1.0009]")).is_ok());
    }

    #[test]
    fn rejects_deep_nesting_and_large_files_immediately() {
        let start = std::time::Instant::now();
        let spaces = (0..1_400).map(|i| format!("{:i$}a:\n", ""));
        let cases = [
            ("[".repeat(100_000), "DIR/g.yml:1:256: recursion limit exceeded; "),
            (format!("a: b\nc: {}", "{a: ".repeat(100_000)), "DIR/g.yml:2:256: "),
            ("[\n".repeat(100_000), "DIR/g.yml:256:1: recursion limit exceeded; "),
            ("- ".repeat(100_000), "DIR/g.yml:1:1: "),
            ("? ".repeat(100_000), "DIR/g.yml:1:129: "),
            (spaces.collect(), "DIR/g.yml"),
            ("&a [*a]\n".repeat(10_000), "DIR/g.yml"),
            ("#".repeat(1 << 20) + "\n", "cannot read DIR/g.yml: the file is larger than the limit of 1048576 bytes"),
        ];
        for (text, message) in cases {
            let error = read_str(&text).unwrap_err();
            assert!(error.starts_with(message), "{error}");
        }
        assert!(start.elapsed().as_secs() < 5, "{:?}", start.elapsed());
    }

    #[test]
    fn parser_errors_are_reported_with_position() {
        let cases = [
            ("gateway2: 1\n", "DIR/g.yml:1:1: missing field `gateway1`"),
            ("gateway1:\n  position: [0, 0]\n", "DIR/g.yml:2:3: expected `gateway1"),
            ("gateway1: [\n", "DIR/g.yml:"),
        ];
        for (text, start) in cases {
            let message = read_str(text).unwrap_err();
            assert!(message.starts_with(start) && message.ends_with(GATEWAY), "{message}");
            assert!(!message.contains("at line"), "{message}");
        }
    }

    #[test]
    fn rejects_second_gateway_unless_named() {
        let pose = |x: u8| format!("{{position: [{x}, 0, 0], orientation: [0, 0, 0, 1]}}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.yml");
        let read = |text: &str, requested| {
            std::fs::write(&path, text).unwrap();
            let read = Gateway::read(&path, requested, "").map(|gateway| gateway.pose.position[0]);
            read.map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
        };
        let two = format!("gateway1: {}\ndataset_name: two\nroof: {}\ncarrier: 9e8\n", pose(1), pose(2));
        assert_eq!(
            read(&two, None).unwrap_err(),
            "DIR/g.yml:3:7: there are more receivers than one, `gateway1` and `roof`, and `Nerf2Spectrum` reads one; name it: \
             Nerf2Spectrum(gateway: \"gateway1\", ..)"
        );
        assert_eq!((read(&two, Some("gateway1")), read(&two, Some("roof"))), (Ok(1.0), Ok(2.0)));
        let error = read(&two, Some("gateway3")).unwrap_err();
        assert_eq!(
            error,
            format!(
                "DIR/g.yml:1:1: missing field `gateway3`; select `gateway1`, `roof`: Nerf2Spectrum(gateway: \"gateway1\", ..), or else {GATEWAY}"
            )
        );
        // Keys called gateway count, other keys are ignored, and recursive aliases are rejected.
        let other_keys = format!("gateway1: {}\nGateway_2: 5\n", pose(1));
        assert!(read(&other_keys, None).unwrap_err().contains("`Gateway_2`"));
        let nine = |i: u8| format!("b{}: &b{} [{}]\n", i + 1, i + 1, vec![format!("*b{i}"); 9].join(", "));
        let grows = (0..20).map(nine).collect::<Vec<_>>().concat();
        let other = format!("gateway1: {}\nb0: &b0 [1, 2]\n{grows}note: {{a: [1, {{b: 2}}]}}\n", pose(1));
        assert!(read(&other, None).unwrap_err().starts_with("DIR/g.yml:8:10: "));
        assert!(read(&format!("gateway1: {0}\ngateway1: {0}\n", pose(1)), None).unwrap_err().contains("duplicate"));
    }
}
