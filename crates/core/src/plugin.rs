//! `Plugin<dyn Trait>`: a boxed plugin that reads `Name(field: value, …)` in RON.
//!
//! typetag alone would want `{"Name": (field: value)}`. The adapter shows it the one-entry map it expects, so that
//! positions in error messages stay right, and asks the plugin to check itself, so that a value out of range is
//! reported where it stands.
use serde::de::{self, DeserializeSeed, Deserializer, EnumAccess, MapAccess, VariantAccess, Visitor};
use serde::{Deserialize, Serialize, Serializer, forward_to_deserialize_any};
use std::{any::Any, fmt, marker::PhantomData, ops::Deref, path::Path, sync::Arc};

/// A plugin of kind `T = dyn Trait`: immutable, shared, cheap to clone.
#[derive(Debug)]
pub struct Plugin<T: ?Sized>(Arc<T>);

impl<T: ?Sized> Clone for Plugin<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

/// A family of plugins: `dyn Trait` for each plugin trait. Implemented by `plugin_kind!`.
pub trait PluginKind: fmt::Debug + Send + Sync {
    /// The trait's name, such as `Pruner`.
    const KIND: &'static str;
    /// The plugin's own `check`.
    fn check_plugin(&self) -> Result<(), String>;
    /// The plugin's own `about`.
    fn about_plugin(&self) -> &'static str;
}

/// Makes a trait with `check` and `about` a family of plugins.
#[macro_export]
macro_rules! plugin_kind {
    ($name:ident) => {
        impl $crate::plugin::PluginKind for dyn $name {
            const KIND: &'static str = stringify!($name);
            fn check_plugin(&self) -> Result<(), String> {
                $name::check(self)
            }
            fn about_plugin(&self) -> &'static str {
                $name::about(self)
            }
        }
    };
}

impl<T: ?Sized> Plugin<T> {
    /// The plugin itself.
    pub fn get(&self) -> &T {
        &self.0
    }
}

impl<T: ?Sized + PluginKind> Plugin<T>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    /// Reads `Name(field: value, …)`.
    ///
    /// # Errors
    /// The parser's words.
    pub fn parse(text: &str) -> Result<Self, String> {
        ron_options().from_str(text).map_err(|e| e.to_string())
    }
}

/// How all RON of this project is read: `Some(..)` may be left out.
pub fn ron_options() -> ron::Options {
    use ron::extensions::Extensions;
    ron::Options::default()
        .with_default_extension(Extensions::UNWRAP_VARIANT_NEWTYPES)
        .with_default_extension(Extensions::UNWRAP_NEWTYPES)
        .with_default_extension(Extensions::IMPLICIT_SOME)
}

/// Reads RON with the project's extensions; suggests the nearest known name for a misspelt one. `path` is for messages.
///
/// # Errors
/// [`Error::Input`](crate::Error::Input) with line and column.
pub fn read_ron<T: de::DeserializeOwned>(text: &str, path: &Path) -> crate::Result<T> {
    ron_options().from_str(text).map_err(|e| {
        let said = e.code.to_string();
        crate::Error::at(path, e.span.end.line, e.span.end.col, format!("{said}{}", suggestion(&said)))
    })
}

/// `; did you mean …?` where the message quotes an unknown name first and known ones after.
fn suggestion(message: &str) -> String {
    let names: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let Some((&wrong, known)) = names.split_first() else { return String::new() };
    if !message.to_lowercase().contains("unexpected") && !message.contains("unknown") {
        return String::new();
    }
    known
        .iter()
        .map(|k| (strsim::damerau_levenshtein(wrong, k), k))
        .min()
        .filter(|(distance, k)| *distance <= 2 + k.len() / 3)
        .map_or_else(String::new, |(_, k)| format!("; did you mean `{k}`?"))
}

/// Plain settings that check themselves while they are read, so that the message carries a position.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Checked<S>(S);

/// Settings that can be out of range.
pub trait Check {
    /// What is wrong and what to do.
    ///
    /// # Errors
    /// That sentence.
    fn check(&self) -> Result<(), String>;
}

impl<S> Deref for Checked<S> {
    type Target = S;
    fn deref(&self) -> &S {
        &self.0
    }
}

impl<S: Check> Checked<S> {
    /// Settings that pass their own check.
    ///
    /// # Errors
    /// What is wrong with them.
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
                let (Name(name), body) = access.variant()?;
                let plugin = Box::<T>::deserialize(Tagged(name.clone(), body))?;
                plugin.check_plugin().map_err(|why| de::Error::custom(format!("{name}: {why}")))?;
                Ok(Plugin::from(plugin))
            }
        }
        d.deserialize_enum(T::KIND, &[], Named(PhantomData))
    }
}

/// A bare identifier, such as the `LearnableMask` of `LearnableMask(lambda: 0.01)`.
struct Name(String);
impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Identifier;
        impl Visitor<'_> for Identifier {
            type Value = Name;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a plugin name")
            }
            fn visit_str<E: de::Error>(self, name: &str) -> Result<Name, E> {
                Ok(Name(name.to_owned()))
            }
        }
        d.deserialize_identifier(Identifier)
    }
}

/// Shows typetag the one-entry map `{name: body}` it expects.
struct Tagged<B>(String, B);
impl<'de, B: VariantAccess<'de>> Deserializer<'de> for Tagged<B> {
    type Error = B::Error;
    fn deserialize_any<W: Visitor<'de>>(self, w: W) -> Result<W::Value, B::Error> {
        w.visit_map(Entry { name: Some(self.0), body: Some(self.1) })
    }
    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option
        unit unit_struct newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}
struct Entry<B> {
    name: Option<String>,
    body: Option<B>,
}
impl<'de, B: VariantAccess<'de>> MapAccess<'de> for Entry<B> {
    type Error = B::Error;
    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, k: K) -> Result<Option<K::Value>, B::Error> {
        self.name.take().map(|n| k.deserialize(de::value::StringDeserializer::new(n))).transpose()
    }
    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, s: S) -> Result<S::Value, B::Error> {
        s.deserialize(Body(self.body.take().expect("key was read first")))
    }
}

/// The variant's body, seen as the plugin struct itself.
struct Body<B>(B);
impl<'de, B: VariantAccess<'de>> Deserializer<'de> for Body<B> {
    type Error = B::Error;
    fn deserialize_any<W: Visitor<'de>>(self, _: W) -> Result<W::Value, B::Error> {
        Err(de::Error::custom("a plugin must be a struct"))
    }
    fn deserialize_struct<W: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        w: W,
    ) -> Result<W::Value, B::Error> {
        self.0.struct_variant(fields, w)
    }
    fn deserialize_unit_struct<W: Visitor<'de>>(self, _: &'static str, w: W) -> Result<W::Value, B::Error> {
        self.0.unit_variant()?;
        w.visit_unit()
    }
    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option
        unit newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

/// Names of all plugins of one kind that are linked into this program, sorted.
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

/// What a plugin has worked out and hands out to find again later: only it knows what is inside.
pub type Cache = Option<Arc<dyn Any + Send + Sync>>;

/// What is in a [`Cache`] that the caller made itself.
///
/// # Panics
/// Where another plugin made it.
pub fn cached<T: 'static>(cache: &Cache) -> &T {
    cache.as_ref().and_then(|found| found.downcast_ref()).expect("what is handed back came from this plugin")
}
