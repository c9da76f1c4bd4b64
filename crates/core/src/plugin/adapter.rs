//! Adapter of `BareName(field: value, …)` for typetag: a map with one entry, whose value is a plain struct.

use super::removed_field;
use crate::did_you_mean;
use serde::de::{self, DeserializeSeed, Deserializer, MapAccess, VariantAccess, Visitor};
use serde::{Deserialize, forward_to_deserialize_any};
use std::fmt;

/// Bare identifier, such as `LearnableMask` in `LearnableMask(lambda: 0.01)`.
pub(super) struct BareName(pub(super) String);
impl<'de> Deserialize<'de> for BareName {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Identifier;
        impl Visitor<'_> for Identifier {
            type Value = BareName;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a plugin name")
            }
            fn visit_str<E: de::Error>(self, name: &str) -> Result<BareName, E> {
                Ok(BareName(name.to_owned()))
            }
        }
        d.deserialize_identifier(Identifier)
    }
}

/// Presents the one-entry map `{name: body}` that typetag expects.
pub(super) struct Tagged<B>(pub(super) String, pub(super) B);
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

/// Entry of [`Tagged`]: key and value are taken one after the other.
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

/// Body of the variant, read as the plugin struct itself.
struct Body<B>(B);
impl<'de, B: VariantAccess<'de>> Deserializer<'de> for Body<B> {
    type Error = B::Error;
    fn deserialize_any<W: Visitor<'de>>(self, _: W) -> Result<W::Value, B::Error> {
        Err(de::Error::custom("a plugin must be a struct"))
    }
    fn deserialize_struct<W: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        w: W,
    ) -> Result<W::Value, B::Error> {
        self.0.struct_variant(fields, FieldChecker { inner: w, plugin: name, fields })
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

/// Rejects unknown fields with their position and the nearest name. Errors that pass through typetag's type-erased
/// deserializer are plain text, from which names cannot be extracted.
/// It wraps the visitor of the plugin, then the map of its fields, then each key.
struct FieldChecker<W> {
    inner: W,
    /// Name of the plugin.
    plugin: &'static str,
    /// Names of its fields.
    fields: &'static [&'static str],
}
impl<'de, W: Visitor<'de>> Visitor<'de> for FieldChecker<W> {
    type Value = W::Value;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.expecting(f)
    }
    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<W::Value, A::Error> {
        self.inner.visit_map(FieldChecker { inner: map, plugin: self.plugin, fields: self.fields })
    }
}
impl<'de, A: MapAccess<'de>> MapAccess<'de> for FieldChecker<A> {
    type Error = A::Error;
    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, k: K) -> Result<Option<K::Value>, A::Error> {
        self.inner.next_key_seed(FieldChecker { inner: k, plugin: self.plugin, fields: self.fields })
    }
    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, s: S) -> Result<S::Value, A::Error> {
        self.inner.next_value_seed(s)
    }
}
impl<'de, K: DeserializeSeed<'de>> DeserializeSeed<'de> for FieldChecker<K> {
    type Value = K::Value;
    fn deserialize<D: Deserializer<'de>>(self, d: D) -> Result<K::Value, D::Error> {
        let BareName(name) = BareName::deserialize(d)?;
        let Self { inner, plugin, fields } = self;
        if let Some(fault) = removed_field(plugin, &name) {
            return Err(de::Error::custom(format!("{plugin} {fault}")));
        }
        if !fields.contains(&name.as_str()) {
            let hint = did_you_mean(&name, fields.iter().copied());
            let valid = fields.join("`, `");
            return Err(de::Error::custom(format!("unknown field `{name}`{hint} (fields: `{valid}`)")));
        }
        inner.deserialize(de::value::StringDeserializer::new(name))
    }
}
