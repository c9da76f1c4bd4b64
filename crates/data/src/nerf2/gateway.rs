//! `gateway_info.yml`: name of the data set, position and orientation of the receiver.

mod file;

use super::yaml::{self, place_of};
use crate::checks::name_fault;
use file::File;
use pwrfgs_core::{Elevation, Error, Pose, Receiver, Result, words::clean};
use std::path::Path;

const EXPECTED: &str =
    "expected `gateway1: {position: [x, y, z], orientation: [x, y, z, w]}` (metres; unit quaternion)";

/// What the file says.
#[derive(Debug, PartialEq)]
pub(crate) struct Gateway {
    pub(crate) name: Option<String>,
    pub(crate) pose: Pose,
    /// What the receiver is called, where it says so.
    receiver: Option<String>,
    /// Of the pictures' rows, where it says so.
    pub(crate) elevation: Option<Elevation>,
}

impl Gateway {
    pub(crate) fn receiver(&self) -> Receiver {
        Receiver::new(self.receiver.as_deref().unwrap_or("receiver"), self.pose)
    }
}

/// Reads the file; `wanted` is the gateway that the user names, `gateway1` where none is named.
pub(crate) fn read(path: &Path, wanted: Option<&str>, advice: &str) -> Result<Gateway> {
    let text = yaml::text(path, advice, EXPECTED)?;
    let name = wanted.unwrap_or("gateway1");
    let file = yaml::parse(path, &text, File { wanted: name }, EXPECTED)?;
    let others = file.others.iter().map(|other| format!("`{}`", clean(other))).collect::<Vec<_>>().join(", ");
    let one = file.others.first().map_or("gateway2", String::as_str);
    let Some(pose) = file.pose else {
        let what = if others.is_empty() {
            format!("missing field `{}`; {EXPECTED}", clean(name))
        } else {
            format!(
                "missing field `{name}`; name {others}: Nerf2Spectrum(gateway: \"{}\", ..), or else {EXPECTED}",
                clean(one)
            )
        };
        return Err(Error::at(path, 1, 1, what));
    };
    if wanted.is_none() && !others.is_empty() {
        let (line, column) = place_of(&text, one, "");
        let what = format!(
            "there are more receivers than one, `{name}` and {others}, and a model hears at one; name it: \
             Nerf2Spectrum(gateway: \"{name}\", ..)"
        );
        return Err(Error::at(path, line, column, what));
    }
    if let Some((field, fault)) = pose.fault() {
        let (line, column) = place_of(&text, name, field);
        return Err(Error::at(path, line, column, fault));
    }
    let elevation = file.elevation.map(|[first, last]| Elevation { first, last });
    if let Some(fault) = elevation.and_then(Elevation::fault) {
        let (line, column) = place_of(&text, "elevation", "");
        return Err(Error::at(path, line, column, fault));
    }
    let is_said = |name: &String| !name.trim().is_empty();
    let receiver = file.receiver.filter(is_said);
    if let Some(fault) = receiver.as_deref().and_then(name_fault) {
        let (line, column) = place_of(&text, "receiver", "");
        return Err(Error::at(path, line, column, fault));
    }
    Ok(Gateway { name: file.title.filter(is_said), pose, receiver, elevation })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_str(text: &str) -> Result<Gateway, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.yml");
        std::fs::write(&path, text).unwrap();
        read(&path, None, "").map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
    }

    #[test]
    fn the_released_file_is_read() {
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
    fn mistakes_are_told_with_their_place() {
        let file = |orientation: &str| format!("gateway1:\n  position: [0, 0, 0]\n  orientation: {orientation}\n");
        let cases = [
            (
                file("[0, 0, 0, 0]"),
                "DIR/g.yml:3:3: the quaternion is zero; write x, y, z, w of length 1, such as [0, 0, 0, 1] for no rotation",
            ),
            (
                file("[0, 0, 0, 1.002]"),
                "DIR/g.yml:3:3: the quaternion has length 1.002000, further than 0.001 from 1; divide x, y, z, w by it",
            ),
            (
                file("[0, .nan, 0, 1]"),
                "DIR/g.yml:3:3: the quaternion is not finite; write x, y, z, w, such as [0, 0, 0, 1] for no rotation",
            ),
            (
                "gateway1: {position: [.inf, 0, 0], orientation: [0, 0, 0, 1]}".into(),
                "DIR/g.yml:1:12: the position is not finite; write three numbers in metres",
            ),
        ];
        for (text, message) in cases {
            assert_eq!(read_str(&text).unwrap_err(), message);
        }
        assert!(read_str(&file("[0, 0, 0, 1.0009]")).is_ok());
    }

    #[test]
    fn deep_nesting_and_large_files_are_refused_at_once() {
        let start = std::time::Instant::now();
        let spaces = (0..1_400).map(|i| format!("{:i$}a:\n", ""));
        let cases = [
            ("[".repeat(100_000), "DIR/g.yml:1:1: nested deeper than 64; "),
            (format!("a: b\nc: {}", "{a: ".repeat(100_000)), "DIR/g.yml:2:1: nested deeper than 64; "),
            ("[\n".repeat(100_000), "DIR/g.yml:65:1: nested deeper than 64; "),
            ("- ".repeat(100_000), "DIR/g.yml:1:1: nested deeper than 64; "),
            ("? ".repeat(100_000), "DIR/g.yml:1:1: nested deeper than 64; "),
            (spaces.collect(), "DIR/g.yml"),
            ("&a [*a]\n".repeat(10_000), "DIR/g.yml"),
            ("#".repeat(1 << 20) + "\n", "cannot read DIR/g.yml: it is larger than the 1048576 bytes"),
        ];
        for (text, message) in cases {
            let said = read_str(&text).unwrap_err();
            assert!(said.starts_with(message), "{said}");
        }
        assert!(start.elapsed().as_secs() < 5, "{:?}", start.elapsed());
    }

    #[test]
    fn the_parsers_words_are_kept() {
        let cases = [
            ("gateway2: 1\n", "DIR/g.yml:1:1: missing field `gateway1`"),
            ("gateway1:\n  position: [0, 0]\n", "DIR/g.yml:2:13: gateway1.position: invalid length 2"),
            ("gateway1: [\n", "DIR/g.yml:"),
        ];
        for (text, start) in cases {
            let message = read_str(text).unwrap_err();
            assert!(message.starts_with(start) && message.ends_with(EXPECTED), "{message}");
            assert!(!message.contains("at line"), "{message}");
        }
    }

    #[test]
    fn a_second_gateway_is_refused_unless_one_is_named() {
        let pose = |x: u8| format!("{{position: [{x}, 0, 0], orientation: [0, 0, 0, 1]}}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.yml");
        let read = |text: &str, wanted| {
            std::fs::write(&path, text).unwrap();
            let read = read(&path, wanted, "").map(|gateway| gateway.pose.position[0]);
            read.map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
        };
        let two = format!("gateway1: {}\ndataset_name: two\nroof: {}\ncarrier: 9e8\n", pose(1), pose(2));
        assert_eq!(
            read(&two, None).unwrap_err(),
            "DIR/g.yml:3:1: there are more receivers than one, `gateway1` and `roof`, and a model hears at one; name it: \
             Nerf2Spectrum(gateway: \"gateway1\", ..)"
        );
        assert_eq!((read(&two, Some("gateway1")), read(&two, Some("roof"))), (Ok(1.0), Ok(2.0)));
        let said = read(&two, Some("gateway3")).unwrap_err();
        assert_eq!(
            said,
            format!(
                "DIR/g.yml:1:1: missing field `gateway3`; name `gateway1`, `roof`: Nerf2Spectrum(gateway: \"gateway1\", ..), or else {EXPECTED}"
            )
        );
        // Whatever is called a gateway counts as one, and other keys are left alone, aliases that would grow included.
        let odd = format!("gateway1: {}\nGateway_2: 5\n", pose(1));
        assert!(read(&odd, None).unwrap_err().contains("`Gateway_2`"));
        let nine = |i: u8| format!("b{}: &b{} [{}]\n", i + 1, i + 1, vec![format!("*b{i}"); 9].join(", "));
        let grows = (0..20).map(nine).collect::<Vec<_>>().concat();
        let other = format!("gateway1: {}\nb0: &b0 [1, 2]\n{grows}note: {{a: [1, {{b: 2}}]}}\n", pose(1));
        assert_eq!(read(&other, None), Ok(1.0));
        assert!(read(&format!("gateway1: {0}\ngateway1: {0}\n", pose(1)), None).unwrap_err().contains("duplicate"));
    }
}
