//! The keys of `gateway_info.yml`, with one gateway read and the others noted. Values of other keys are passed over and
//! never built: aliases may stand for any number of them.

use pwrfgs_core::Pose;
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, de};
use std::fmt::{Display, Formatter, Result as Written};

/// How to read the file: which gateway is wanted.
pub(super) struct File<'a> {
    pub(super) wanted: &'a str,
}

/// What it says.
#[derive(Default)]
pub(super) struct Contents {
    /// `dataset_name`, a text or a number.
    pub(super) title: Option<String>,
    /// `receiver`, its name.
    pub(super) receiver: Option<String>,
    /// `elevation`, degrees.
    pub(super) elevation: Option<[f64; 2]>,
    /// The gateway that is wanted.
    pub(super) pose: Option<Pose>,
    /// Keys of other gateways: they begin with `gateway`, or hold a `position`.
    pub(super) others: Vec<String>,
}

impl<'de> DeserializeSeed<'de> for File<'_> {
    type Value = Contents;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Contents, D::Error> {
        from.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for File<'_> {
    type Value = Contents;

    fn expecting(&self, f: &mut Formatter<'_>) -> Written {
        write!(f, "keys with values")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Contents, A::Error> {
        let mut contents = Contents::default();
        while let Some(key) = map.next_key::<String>()? {
            let twice = || A::Error::custom(format!("duplicate field `{key}`"));
            if key == self.wanted {
                let pose = map.next_value()?;
                if contents.pose.replace(pose).is_some() {
                    return Err(twice());
                }
            } else if key == "dataset_name" {
                contents.title = map.next_value::<Glance>()?.scalar;
            } else if key == "elevation" {
                contents.elevation = Some(map.next_value()?);
            } else {
                let seen = map.next_value::<Glance>()?;
                if key == "receiver" && seen.scalar.is_some() {
                    contents.receiver = seen.scalar;
                } else if seen.has_position || key.to_lowercase().starts_with("gateway") {
                    contents.others.push(key);
                }
            }
        }
        Ok(contents)
    }
}

/// What a first look at a value shows.
#[derive(Default)]
struct Glance {
    /// A text or a number.
    scalar: Option<String>,
    has_position: bool,
}

impl Glance {
    fn of(scalar: impl Display) -> Self {
        Self { scalar: Some(scalar.to_string()), has_position: false }
    }
}

impl<'de> Deserialize<'de> for Glance {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Look;
        impl<'de> Visitor<'de> for Look {
            type Value = Glance;

            fn expecting(&self, f: &mut Formatter<'_>) -> Written {
                write!(f, "any value")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Glance, A::Error> {
                let mut has_position = false;
                while let Some(key) = map.next_key::<Glance>()? {
                    has_position |= key.scalar.as_deref() == Some("position");
                    map.next_value::<IgnoredAny>()?;
                }
                Ok(Glance { has_position, ..Glance::default() })
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Glance, A::Error> {
                while seq.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Glance::default())
            }

            fn visit_str<E: de::Error>(self, v: &str) -> Result<Glance, E> {
                Ok(Glance::of(v))
            }

            fn visit_u64<E: de::Error>(self, v: u64) -> Result<Glance, E> {
                Ok(Glance::of(v))
            }

            fn visit_i64<E: de::Error>(self, v: i64) -> Result<Glance, E> {
                Ok(Glance::of(v))
            }

            fn visit_f64<E: de::Error>(self, v: f64) -> Result<Glance, E> {
                Ok(Glance::of(v))
            }

            fn visit_bool<E: de::Error>(self, _: bool) -> Result<Glance, E> {
                Ok(Glance::default())
            }

            fn visit_unit<E: de::Error>(self) -> Result<Glance, E> {
                Ok(Glance::default())
            }
        }
        from.deserialize_any(Look)
    }
}
