//! What the comments in the source say, at hand while the program runs: the one origin of `pwrfgs plugins`, of the comments
//! in a pipeline that `pwrfgs init` writes, of Python's classes and of the schema for editors.
//!
//! A type that derives [`JsonSchema`] has a JSON schema with its doc comments, types and defaults. [`Docs`] is a schema as a
//! table of fields or variants, in the words of a pipeline file.

pub use schemars::{self, JsonSchema};
use schemars::{Schema, SchemaGenerator};
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Every type that derives [`JsonSchema`], behind a trait object too.
pub trait Documented {
    /// Its doc comments.
    fn docs(&self) -> &'static Docs;
    /// Its schema, or a reference to one among those of `generator`.
    fn schema(&self, generator: &mut SchemaGenerator) -> Schema;
}

impl<T: JsonSchema> Documented for T {
    fn docs(&self) -> &'static Docs {
        Docs::of::<T>()
    }

    fn schema(&self, generator: &mut SchemaGenerator) -> Schema {
        generator.subschema_for::<T>()
    }
}

/// What may stand in a place.
#[derive(Clone, Debug)]
pub enum Kind {
    /// A plain value, in words, such as `number`.
    Plain(&'static str),
    /// A struct or enum.
    Of(&'static Docs),
    /// A plugin of this kind.
    Plugin(&'static str),
    /// This or `None`.
    Optional(Box<Self>),
    /// Any number of these, in brackets.
    List(Box<Self>),
    /// These, in parentheses.
    Tuple(Vec<Self>),
    /// These by a name, in braces.
    Map(Box<Self>),
}

/// A struct or enum, in the words of its source.
#[derive(Debug)]
pub struct Docs {
    /// Its name.
    pub name: &'static str,
    /// Its doc comment.
    pub text: &'static str,
    /// What it is made of.
    pub body: Body,
}

/// What a type is made of.
#[derive(Debug)]
pub enum Body {
    /// A struct.
    Fields(&'static [Field]),
    /// An enum.
    Variants(&'static [Variant]),
}

/// A field.
#[derive(Debug)]
pub struct Field {
    /// Its name; `_0` for the first of an unnamed list.
    pub name: &'static str,
    /// Its doc comment.
    pub text: &'static str,
    /// Whether it may be left out.
    pub optional: bool,
    /// What it takes.
    pub kind: Kind,
}

/// A variant of an enum.
#[derive(Debug)]
pub struct Variant {
    /// Its name.
    pub name: &'static str,
    /// Its doc comment.
    pub text: &'static str,
    /// Whether its fields have names.
    pub named: bool,
    /// Its fields.
    pub fields: &'static [Field],
}

impl Kind {
    /// The struct or enum that is meant, through `Option`.
    pub fn docs(&self) -> Option<&'static Docs> {
        match self {
            Self::Of(docs) => Some(docs),
            Self::Optional(inner) => inner.docs(),
            _ => None,
        }
    }

    /// In words: `number`, `list of Pruner`, `path or None`.
    pub fn words(&self) -> String {
        match self {
            Self::Plain(words) => (*words).into(),
            Self::Of(docs) => docs.name.into(),
            Self::Plugin(kind) => (*kind).into(),
            Self::Optional(inner) => format!("{} or None", inner.words()),
            Self::List(inner) => format!("list of {}", inner.words()),
            Self::Tuple(parts) => {
                let parts: Vec<String> = parts.iter().map(Self::words).collect();
                format!("({})", parts.join(", "))
            }
            Self::Map(inner) => format!("{} by name", inner.words()),
        }
    }
}

impl Docs {
    /// What the schema of a type says. A type is read once and stays in memory.
    pub fn of<T: JsonSchema>() -> &'static Self {
        static READ: Mutex<BTreeMap<Cow<'static, str>, &'static Docs>> = Mutex::new(BTreeMap::new());
        let read = || READ.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(docs) = read().get(&T::schema_id()) {
            return docs;
        }
        let schema = SchemaGenerator::default().into_root_schema_for::<T>().to_value();
        let none = Map::new();
        let types = schema.get("$defs").and_then(Value::as_object).unwrap_or(&none);
        let docs = Reader { types }.docs(&T::schema_name(), &schema);
        read().insert(T::schema_id(), docs);
        docs
    }

    /// The fields of a struct.
    pub fn fields(&self) -> &'static [Field] {
        match self.body {
            Body::Fields(fields) => fields,
            Body::Variants(_) => &[],
        }
    }

    /// The field of a struct, or of the enum's variant `variant`, that is called `name`.
    pub fn field(&self, variant: Option<&str>, name: &str) -> Option<&'static Field> {
        let fields = match self.body {
            Body::Fields(fields) => fields,
            Body::Variants(variants) => variants.iter().find(|v| Some(v.name) == variant)?.fields,
        };
        fields.iter().find(|field| field.name == name)
    }
}

/// Reads schemas that refer to `types` by name.
struct Reader<'a> {
    types: &'a Map<String, Value>,
}

impl Reader<'_> {
    fn docs(&self, name: &str, schema: &Value) -> &'static Docs {
        let variants = match schema.get("oneOf").and_then(Value::as_array) {
            Some(all) => Some(all.iter().flat_map(|one| self.variants(one)).collect()),
            None => schema.get("enum").is_some().then(|| self.variants(schema)),
        };
        let body = match variants {
            Some(variants) => Body::Variants(variants.leak()),
            None => Body::Fields(self.fields(schema)),
        };
        Box::leak(Box::new(Docs { name: kept(name), text: description(schema), body }))
    }

    /// The variants of an enum that one of its schemas stands for.
    fn variants(&self, schema: &Value) -> Vec<Variant> {
        let text = description(schema);
        let plain = |name: &str| Variant { name: kept(name), text, named: false, fields: &[] };
        if let Some(names) = schema.get("enum").and_then(Value::as_array) {
            return names.iter().filter_map(Value::as_str).map(plain).collect();
        }
        if let Some(name) = schema.get("const").and_then(Value::as_str) {
            return vec![plain(name)];
        }
        let holds = schema.get("properties").and_then(Value::as_object);
        let with_fields = |(name, inside): (&String, &Value)| {
            let named = inside.get("properties").is_some();
            let unnamed = match inside.get("prefixItems").and_then(Value::as_array) {
                Some(items) => &items[..],
                None => std::slice::from_ref(inside),
            };
            let field = |(i, item)| self.field(&format!("_{i}"), item, false);
            let fields = if named {
                self.fields(inside)
            } else {
                unnamed.iter().enumerate().map(field).collect::<Vec<_>>().leak()
            };
            Variant { name: kept(name), text, named, fields }
        };
        holds.into_iter().flatten().map(with_fields).collect()
    }

    /// The fields of a struct, or of a variant with names.
    fn fields(&self, schema: &Value) -> &'static [Field] {
        let required: Vec<&str> =
            schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str).collect();
        let all = schema.get("properties").and_then(Value::as_object).into_iter().flatten();
        let field = |(name, of): (&String, &Value)| self.field(name, of, !required.contains(&&name[..]));
        all.map(field).collect::<Vec<_>>().leak()
    }

    fn field(&self, name: &str, schema: &Value, optional: bool) -> Field {
        Field { name: kept(name), text: description(schema), optional, kind: self.kind(schema) }
    }

    fn kind(&self, schema: &Value) -> Kind {
        let nullable = schema["type"].as_array().is_some_and(|types| types.contains(&"null".into()));
        if nullable { Kind::Optional(Box::new(self.inner_kind(schema))) } else { self.inner_kind(schema) }
    }

    /// The same without `None`.
    fn inner_kind(&self, schema: &Value) -> Kind {
        if let Some(words) = schema.get("title").and_then(Value::as_str) {
            return Kind::Plain(kept(words));
        }
        if let Some(name) = schema.get("$ref").and_then(Value::as_str) {
            let name = name.rsplit('/').next().unwrap_or_default();
            let of = &self.types[name];
            return if of.get(PLUGINS).is_some() { Kind::Plugin(kept(name)) } else { Kind::Of(self.docs(name, of)) };
        }
        if let Some([inner, _null]) = schema.get("anyOf").and_then(Value::as_array).map(Vec::as_slice) {
            return Kind::Optional(Box::new(self.kind(inner)));
        }
        let kind = match &schema["type"] {
            Value::Array(types) => &types[0],
            kind => kind,
        };
        let inside = |key: &str| self.kind(&schema[key]);
        match (kind.as_str().unwrap_or_default(), schema.get("prefixItems"), schema.get("minItems")) {
            ("array", Some(Value::Array(items)), _) => Kind::Tuple(items.iter().map(|item| self.kind(item)).collect()),
            ("array", _, Some(length)) => Kind::Tuple(vec![inside("items"); length.as_u64().unwrap_or(1) as usize]),
            ("array", ..) => Kind::List(Box::new(inside("items"))),
            ("object", ..) => Kind::Map(Box::new(inside("additionalProperties"))),
            ("boolean", ..) => Kind::Plain("true or false"),
            ("integer", ..) => Kind::Plain("whole number"),
            ("number", ..) => Kind::Plain("number"),
            ("string", ..) if schema["format"] == "path" => Kind::Plain("path"),
            ("string", ..) => Kind::Plain("text"),
            _ => Kind::Plain("value"),
        }
    }
}

/// The keyword of a schema whose variants are all plugins of a kind.
pub(crate) const PLUGINS: &str = "x-plugins";

fn description(schema: &Value) -> &'static str {
    kept(schema.get("description").and_then(Value::as_str).unwrap_or_default().trim())
}

fn kept(text: &str) -> &'static str {
    Box::leak(text.into())
}
