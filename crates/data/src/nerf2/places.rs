//! Files that say where several receivers are: `gateway_position.yml` and `base-station.yml`.

use super::yaml::{self, place_of};
use crate::checks::name_fault;
use pwrfgs_core::place_fault;
use pwrfgs_core::{Error, Pose, Result, words::clean};
use serde::Deserialize;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::collections::BTreeSet;
use std::fmt::{Formatter, Result as Written};
use std::path::Path;

const GATEWAYS: &str = "expected one gateway a line, such as `g01: [x, y, z]` (metres), or `g01: {position: [x, y, z], \
                        orientation: [x, y, z, w]}`";
const ANTENNAS: &str = "expected `base_station: [[x, y, z], ..]` (metres), a place for each antenna";

/// Names and poses of the gateways in the order of the file; without an orientation, axes are those of the world.
pub(super) fn gateways(path: &Path, advice: &str) -> Result<Vec<(String, Pose)>> {
    let text = yaml::text(path, advice, GATEWAYS)?;
    let found = yaml::parse(path, &text, Gateways, GATEWAYS)?;
    for (name, pose) in &found {
        let place = place_fault(pose.position);
        let fault = place.or_else(|| pose.fault().map(|(_, fault)| format!("is turned: {fault}")));
        let fault = fault.map(|fault| format!("`{}` {fault}", clean(name)));
        if let Some(fault) = name_fault(name).or(fault) {
            let (line, column) = place_of(&text, name, "");
            return Err(Error::at(path, line, column, fault));
        }
    }
    if found.is_empty() {
        return Err(Error::input(path, format!("names no gateway; {GATEWAYS}")));
    }
    Ok(found)
}

/// Places of the antennas of a base station `[A,3]`, metres.
pub(super) fn antennas(path: &Path, advice: &str) -> Result<Vec<[f64; 3]>> {
    let text = yaml::text(path, advice, ANTENNAS)?;
    let found = yaml::parse(path, &text, Antennas, ANTENNAS)?;
    if let Some((k, fault)) = found.iter().enumerate().find_map(|(k, place)| Some((k, place_fault(*place)?))) {
        let (line, column) = place_of(&text, "base_station", "");
        return Err(Error::at(path, line, column, format!("antenna {} {fault}", k + 1)));
    }
    if found.is_empty() {
        return Err(Error::input(path, format!("names no antenna; {ANTENNAS}")));
    }
    Ok(found)
}

/// Every key is a gateway.
struct Gateways;

impl<'de> DeserializeSeed<'de> for Gateways {
    type Value = Vec<(String, Pose)>;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Self::Value, D::Error> {
        from.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Gateways {
    type Value = Vec<(String, Pose)>;

    fn expecting(&self, f: &mut Formatter<'_>) -> Written {
        write!(f, "names with places")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut found, mut seen) = (Vec::new(), BTreeSet::new());
        while let Some(name) = map.next_key::<String>()? {
            if !seen.insert(name.clone()) {
                return Err(A::Error::custom(format!("the gateway `{}` comes twice", clean(&name))));
            }
            let Gateway(pose) = map.next_value()?;
            found.push((name, pose));
        }
        Ok(found)
    }
}

/// A position, or a pose.
struct Gateway(Pose);

impl<'de> Deserialize<'de> for Gateway {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Look;
        impl<'de> Visitor<'de> for Look {
            type Value = Gateway;

            fn expecting(&self, f: &mut Formatter<'_>) -> Written {
                write!(f, "a position")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Gateway, A::Error> {
                let position = Deserialize::deserialize(SeqAccessDeserializer::new(seq))?;
                Ok(Gateway(Pose { position, ..Pose::IDENTITY }))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Gateway, A::Error> {
                Pose::deserialize(MapAccessDeserializer::new(map)).map(Gateway)
            }
        }
        from.deserialize_any(Look)
    }
}

/// One key counts, others are passed over.
struct Antennas;

impl<'de> DeserializeSeed<'de> for Antennas {
    type Value = Vec<[f64; 3]>;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Self::Value, D::Error> {
        from.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Antennas {
    type Value = Vec<[f64; 3]>;

    fn expecting(&self, f: &mut Formatter<'_>) -> Written {
        write!(f, "a key `base_station`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut found = None;
        while let Some(key) = map.next_key::<String>()? {
            if key != "base_station" {
                map.next_value::<IgnoredAny>()?;
            } else if found.replace(map.next_value()?).is_some() {
                return Err(A::Error::custom("`base_station` comes twice"));
            }
        }
        found.ok_or_else(|| A::Error::missing_field("base_station"))
    }
}
