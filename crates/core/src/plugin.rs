//! `Plugin<dyn Trait>`: a boxed plugin that is read from `BareName(field: value, …)` in RON.
//!
//! typetag alone requires `{"BareName": (field: value)}`. The adapter presents the one-entry map that typetag expects, so
//! that positions in error messages are correct. It then calls the plugin's own check, so that errors of range have a
//! position too.
mod adapter;
mod removed;

use crate::did_you_mean;
use crate::docs::{Docs, Documented, JsonSchema, PLUGINS};
use adapter::{BareName, Tagged};
pub use inventory;
pub use removed::{REMOVED_FIELDS, removed_field};
use schemars::{Schema, SchemaGenerator, json_schema};
use serde::de::{self, Deserializer, EnumAccess, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Map, json};
use std::{any::Any, borrow::Cow, fmt, marker::PhantomData, ops::Deref, path::Path, sync::Arc};

/// Plugin of kind `T = dyn Trait`: immutable, shared, cheap to clone.
#[derive(Debug)]
pub struct Plugin<T: ?Sized>(Arc<T>);

impl<T: ?Sized> Clone for Plugin<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

/// Bounds of every plugin trait. All types with the usual derives implement it.
pub trait PluginObject: erased_serde::Serialize + Documented + std::any::Any + fmt::Debug + Send + Sync {}

impl<T: erased_serde::Serialize + Documented + std::any::Any + fmt::Debug + Send + Sync> PluginObject for T {}

/// Kind of plugins: `dyn Trait` for each plugin trait. Implemented by `plugin_kind!`.
pub trait PluginKind: Documented + fmt::Debug + Send + Sync {
    /// Name of the trait, such as `Pruner`.
    const KIND: &'static str;
    /// Calls the `check` of the plugin.
    fn check_plugin(&self) -> Result<(), String>;
}

/// Makes a trait with `check` a kind of plugins.
#[macro_export]
macro_rules! plugin_kind {
    ($name:ident) => {
        impl $crate::plugin::PluginKind for dyn $name {
            const KIND: &'static str = stringify!($name);
            fn check_plugin(&self) -> Result<(), String> {
                $name::check(self)
            }
        }
        $crate::plugin::inventory::submit! { $crate::plugin::PluginFamily::of::<dyn $name>() }
    };
}

impl<T: ?Sized> Plugin<T> {
    /// Returns the plugin.
    pub fn get(&self) -> &T {
        &self.0
    }
}

impl<T: ?Sized + PluginKind> Plugin<T>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    /// Reads `BareName(field: value, …)`.
    ///
    /// # Errors
    /// The text is not valid RON, names an unknown plugin or field, or has an invalid value; the message is that of the
    /// parser.
    pub fn parse(text: &str) -> Result<Self, String> {
        ron_options().from_str(text).map_err(|e| e.to_string())
    }
}

/// Any of the linked plugins, by name; plugins without default values are left out.
impl<T: ?Sized + PluginKind> JsonSchema for Plugin<T>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    fn schema_name() -> Cow<'static, str> {
        T::KIND.into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let linked = registered::<T>().into_iter();
        let plugins = linked.filter_map(|name| Some((name, Self::parse(&format!("{name}()")).ok()?)));
        let variant = |(name, plugin): (&str, Self)| {
            let properties = Map::from_iter([(name.to_owned(), plugin.get().schema(generator).to_value())]);
            json!({ "type": "object", "properties": properties, "required": [name], "additionalProperties": false })
        };
        json_schema!({ "oneOf": plugins.map(variant).collect::<Vec<_>>(), PLUGINS: true })
    }
}

/// Returns the RON options of this project: `Some(..)` and the wrappers of newtypes may be omitted.
pub fn ron_options() -> ron::Options {
    use ron::extensions::Extensions;
    ron::Options::default()
        .with_default_extension(Extensions::UNWRAP_VARIANT_NEWTYPES)
        .with_default_extension(Extensions::UNWRAP_NEWTYPES)
        .with_default_extension(Extensions::IMPLICIT_SOME)
}

/// Writes plain data as RON text with all names; [`read_ron`] restores it exactly. Panics for other data: see [`try_to_ron`].
pub fn to_ron(value: &impl Serialize) -> String {
    try_to_ron(value).expect("settings are plain data")
}

/// Writes data of third-party plugins as RON text with all names.
///
/// # Errors
/// The value is not plain data.
pub fn try_to_ron(value: &impl Serialize) -> Result<String, String> {
    let config = ron::ser::PrettyConfig::new().struct_names(true).depth_limit(6); // deeper values are on one line
    ron_options().to_string_pretty(value, config).map_err(|e| e.to_string())
}

/// Writes a value as RON on one line; empty if RON cannot hold it.
pub fn ron_line(value: &impl Serialize) -> String {
    let config = ron::ser::PrettyConfig::new().struct_names(true).depth_limit(0);
    ron_options().to_string_pretty(value, config).unwrap_or_default()
}

/// Returns the name of a plugin, such as `Zero` of `Zero()`.
pub fn name_of(plugin: &impl Serialize) -> String {
    let text = to_ron(plugin);
    text.split(['(', '{']).next().unwrap_or_default().trim().to_owned()
}

/// Returns the name of a plugin for messages: for a plugin in Python, such as `Python(.., class: "Thin", ..)`, its class.
pub fn title_of(plugin: &impl Serialize) -> String {
    let (name, text) = (name_of(plugin), to_ron(plugin));
    let class = || text.split_once("class:")?.1.split('"').nth(1);
    if name == "Python" { class().unwrap_or(&name).to_owned() } else { name }
}

/// Reads RON with the project's extensions; suggests the nearest known name for a misspelt one. `path` is for messages.
///
/// # Errors
/// [`Error::Input`](crate::Error::Input) with line and column if the text is not valid RON, has an unknown name or
/// an invalid value, or lacks a field.
pub fn read_ron<T: de::DeserializeOwned>(text: &str, path: &Path) -> crate::Result<T> {
    ron_options().from_str(text).map_err(|e| crate::Error::at(path, e.span.end.line, e.span.end.col, explain(&e)))
}

/// Describes an error in RON text, with the nearest known name for a misspelt one, and the command for a pipeline or experiment
/// in place of another file.
pub fn explain(error: &ron::error::SpannedError) -> String {
    use ron::Error::{
        ExpectedDifferentStructName, MissingStructField, NoSuchEnumVariant, NoSuchStructField, SuggestRawIdentifier,
    };
    let hint = match &error.code {
        NoSuchEnumVariant { expected, found, .. } | NoSuchStructField { expected, found, .. } => {
            did_you_mean(found, expected.iter().copied())
        }
        ExpectedDifferentStructName { found, .. } if found == "Pipeline" => "; use this file with `pwrfgs run`".into(),
        ExpectedDifferentStructName { found, .. } if found == "Experiment" => {
            "; use this file with `pwrfgs sweep`".into()
        }
        _ => String::new(),
    };
    let problem = match &error.code {
        SuggestRawIdentifier(found) => format!("`{found}` found, expected a name"),
        MissingStructField { field, .. } => format!("the field `{field}` is missing"),
        code => code.to_string(),
    };
    problem + &hint
}

/// Settings that are checked while they are read, so that messages have a position.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Checked<S>(S);

/// Settings with a check of their values.
pub trait Check {
    /// Checks the values.
    ///
    /// # Errors
    /// A value is invalid; the message states the problem and the next step.
    fn check(&self) -> Result<(), String>;
}

impl<S: JsonSchema> JsonSchema for Checked<S> {
    fn schema_name() -> Cow<'static, str> {
        S::schema_name()
    }

    fn schema_id() -> Cow<'static, str> {
        S::schema_id()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        S::json_schema(generator)
    }
}

impl<S> Deref for Checked<S> {
    type Target = S;
    fn deref(&self) -> &S {
        &self.0
    }
}

impl<S: Check> Checked<S> {
    /// Checks settings and wraps them.
    ///
    /// # Errors
    /// As [`Check::check`].
    pub fn new(settings: S) -> Result<Self, String> {
        settings.check().map(|()| Self(settings))
    }
}

impl<'de, S: Deserialize<'de> + Check> Deserialize<'de> for Checked<S> {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        Self::new(S::deserialize(d)?).map_err(de::Error::custom)
    }
}

impl<T: ?Sized> From<Box<T>> for Plugin<T> {
    fn from(plugin: Box<T>) -> Self {
        Self(plugin.into())
    }
}

impl<T: ?Sized> Deref for Plugin<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T: ?Sized + erased_serde::Serialize> Serialize for Plugin<T> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        erased_serde::serialize(&*self.0, s)
    }
}

impl<'de, T: ?Sized + PluginKind> Deserialize<'de> for Plugin<T>
where
    Box<T>: Deserialize<'de>,
{
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Named<T: ?Sized>(PhantomData<Box<T>>);
        impl<'de, T: ?Sized + PluginKind> Visitor<'de> for Named<T>
        where
            Box<T>: Deserialize<'de>,
        {
            type Value = Plugin<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a plugin, written `Name(field: value, …)`")
            }
            fn visit_enum<A: EnumAccess<'de>>(self, access: A) -> Result<Self::Value, A::Error> {
                let (BareName(name), body) = access.variant()?;
                let plugin = Box::<T>::deserialize(Tagged(name.clone(), body))?;
                plugin.check_plugin().map_err(|fault| de::Error::custom(format!("{name}: {fault}")))?;
                Ok(Plugin::from(plugin))
            }
        }
        d.deserialize_enum(T::KIND, &[], Named(PhantomData))
    }
}

/// Returns the names of all linked plugins of one kind, sorted. typetag lists them only in its error for an unknown name.
pub fn registered<T: ?Sized>() -> Vec<&'static str>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    #[derive(Debug)]
    struct Probe(Vec<&'static str>);
    impl fmt::Display for Probe {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "{:?}", self.0)
        }
    }
    impl std::error::Error for Probe {}
    impl de::Error for Probe {
        fn custom<M: fmt::Display>(_: M) -> Self {
            Self(vec![])
        }
        fn unknown_variant(_: &str, expected: &'static [&'static str]) -> Self {
            Self(expected.to_vec())
        }
    }
    let probe = de::value::MapDeserializer::<_, Probe>::new([("", 0u8)].into_iter());
    let mut names = Box::<T>::deserialize(probe).err().map_or_else(Vec::new, |p| p.0);
    names.sort_unstable();
    names
}

/// Cached result of a plugin, opaque to all others.
pub type Cache = Option<Arc<dyn Any + Send + Sync>>;

/// Returns the content of a [`Cache`] that the caller created.
///
/// # Panics
/// If it is `None`, or another plugin created it.
pub fn cached<T: 'static>(cache: &Cache) -> &T {
    cache.as_ref().and_then(|content| content.downcast_ref()).expect("a plugin receives its own cache")
}

/// Kind of plugins with its linked members, independent of the trait.
#[derive(Debug)]
pub struct PluginFamily {
    /// Name of the trait, such as `Pruner`.
    pub kind: &'static str,
    /// Returns all linked plugins of this kind, sorted by name.
    pub members: fn() -> Vec<PluginEntry>,
    /// Returns a plugin of this kind with all default values written out.
    ///
    /// # Errors
    /// As [`read_ron`], with the position in the text.
    pub complete: fn(&str) -> crate::Result<String>,
    /// Returns the documentation of the plugin in a text of this kind; `None` if the text is not a plugin.
    pub docs: fn(&str) -> Option<&'static Docs>,
}
inventory::collect!(PluginFamily);

/// One linked plugin.
#[derive(Clone, Debug)]
pub struct PluginEntry {
    /// Name of the plugin.
    pub name: &'static str,
    /// Documentation of the plugin; `None` if it has no default values.
    pub docs: Option<&'static Docs>,
    /// Plugin with its default values as RON, or the reason why it has none.
    pub text: Result<String, String>,
}

impl PluginFamily {
    /// Returns the kind of `T`.
    pub const fn of<T: ?Sized + PluginKind + erased_serde::Serialize>() -> Self
    where
        Box<T>: for<'de> Deserialize<'de>,
    {
        Self {
            kind: T::KIND,
            members: members::<T>,
            complete: |text| read_ron::<Plugin<T>>(text, Path::new(T::KIND)).map(|p| to_ron(&p)),
            docs: |text| Plugin::<T>::parse(text).ok().map(|plugin| plugin.get().docs()),
        }
    }

    /// Returns the kind of this name; `None` if there is none.
    pub fn find(kind: &str) -> Option<&'static Self> {
        inventory::iter::<Self>().find(|family| family.kind == kind)
    }
}

/// Lists the linked plugins of one kind, with their default values.
fn members<T: ?Sized + PluginKind + erased_serde::Serialize>() -> Vec<PluginEntry>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    let describe = |name| match Plugin::<T>::parse(&format!("{name}()")) {
        Ok(plugin) => PluginEntry { name, docs: Some(plugin.get().docs()), text: Ok(to_ron(&plugin)) },
        Err(fault) => PluginEntry { name, docs: None, text: Err(fault) },
    };
    registered::<T>().into_iter().map(describe).collect()
}
