//! `Change`: a pipeline path and its new value, from `--set`, a file or a program.

use crate::ron_tree::RonTree;
use pwrfgs_core::{Error, JsonSchema, Result};
use ron::value::RawValue;
use schemars::{Schema, SchemaGenerator, json_schema};
use serde::de::{self, Deserialize, Deserializer, MapAccess, Visitor};
use std::borrow::Cow;
use std::fmt;

/// Largest number of characters of a text that a message repeats.
const LONGEST: usize = 200;

/// Pipeline path, such as `training.steps` or `pruners.LearnableMask.lambda`, and its new value.
#[derive(Clone, Debug)]
pub struct Change {
    /// Path from the pipeline to the value, separated by dots.
    pub path: String,
    /// The value as RON.
    pub value: String,
    /// Name of the change in messages.
    pub name: String,
    /// Line and column of the path, from 1, in the file that holds it.
    pub at: Option<(usize, usize)>,
}

impl Change {
    /// Creates a change of `path` to the RON text `value`.
    pub fn new(path: &str, value: &str) -> Self {
        let name = format!("{path} = {}", shortened(value));
        Self { path: path.into(), value: value.into(), name, at: None }
    }

    /// Parses the argument `path=value` of `--set`.
    ///
    /// # Errors
    /// [`Error::Config`] if there is no `=`.
    pub fn parse_argument(argument: &str) -> Result<Self> {
        let name = format!("--set {}", shortened(argument));
        let Some((path, value)) = argument.split_once('=') else {
            return Err(Error::Config(format!("{name}: write it as path.to.field=value")));
        };
        Ok(Self { path: path.into(), value: value.into(), name, at: None })
    }

    /// Returns the name of the pipeline field that changes completely or in part.
    pub fn field(&self) -> &str {
        self.path.split('.').next().unwrap_or_default().trim()
    }
}

/// List of changes as in files: `{"training.steps": 500, "split": Voxel(size_m: 0.2)}`, applied in this order.
#[derive(Clone, Debug, Default)]
pub struct Changes(pub Vec<Change>);

impl Changes {
    /// Returns whether a change affects `field` of a pipeline.
    pub fn has_field(&self, field: &str) -> bool {
        self.0.iter().any(|change| change.field() == field)
    }

    /// Returns the changes with the common `name` for messages. Their positions are those of their keys in `map`, a value of
    /// `text`; none without `map`.
    #[must_use]
    pub fn located(&self, name: &str, map: Option<&RonTree>, text: &str) -> Self {
        let mut keys = map.map_or_else(Vec::new, |map| map.key_spans(text)).into_iter();
        let mut with_position = |change: &Change| {
            let at = keys.next().map(|key| line_and_column(text, key.start));
            Change { name: name.into(), at, ..change.clone() }
        };
        Self(self.0.iter().map(&mut with_position).collect())
    }
}

impl<'de> Deserialize<'de> for Changes {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Map;
        impl<'de> Visitor<'de> for Map {
            type Value = Changes;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("values by their path, such as {\"training.steps\": 500}")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Changes, A::Error> {
                let mut changes: Vec<Change> = Vec::new();
                while let Some((path, value)) = map.next_entry::<String, Box<RawValue>>()? {
                    if changes.iter().any(|change| change.path == path) {
                        return Err(de::Error::custom(format!("`{}` is given twice", shortened(&path))));
                    }
                    changes.push(Change::new(&path, value.get_ron()));
                }
                Ok(Changes(changes))
            }
        }
        d.deserialize_map(Map)
    }
}

impl JsonSchema for Changes {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "values by their path".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "title": Self::schema_name(), "type": "object" })
    }
}

/// Returns the line and column of the byte `at` of `text`, both counted from 1.
pub(crate) fn line_and_column(text: &str, at: usize) -> (usize, usize) {
    let before = &text[..at];
    let line = before.matches('\n').count() + 1;
    (line, before.chars().rev().take_while(|c| *c != '\n').count() + 1)
}

/// Returns a text for messages: control characters are replaced, and of more than [`LONGEST`] characters, the first and
/// `..` remain, since an argument can be a whole file.
pub(crate) fn shortened(text: &str) -> String {
    let printable = |c: char| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c };
    let short: String = text.chars().take(LONGEST).map(printable).collect();
    if text.chars().nth(LONGEST).is_some() { short + ".." } else { short }
}
