//! Doc comments of the source, available at run time. They are the only source of `pwrfgs plugins`, of the comments in
//! a pipeline that `pwrfgs init` writes, of the Python classes and of the schema for editors.
//!
//! A type that derives [`JsonSchema`] has a JSON schema with its doc comments, types and defaults. [`Docs`] presents a
//! schema as a table of fields or variants, in the notation of a pipeline file.

pub use schemars::{self, JsonSchema};
use schemars::{Schema, SchemaGenerator};
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Access to the documentation of types that derive [`JsonSchema`], also behind a trait object.
pub trait Documented {
    /// Returns its doc comments.
    fn docs(&self) -> &'static Docs;
    /// Returns its schema, or a reference to one in `generator`.
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

/// Type of a field.
#[derive(Clone, Debug)]
pub enum DocKind {
    /// Plain value, described in words, such as `number`.
    Plain(&'static str),
    /// Struct or enum.
    Of(&'static Docs),
    /// Plugin of this kind.
    Plugin(&'static str),
    /// Value or `None`.
    Optional(Box<Self>),
    /// List in brackets.
    List(Box<Self>),
    /// Tuple in parentheses.
    Tuple(Vec<Self>),
    /// Map by name, in braces.
    Map(Box<Self>),
}

/// Documentation of a struct or enum.
#[derive(Debug)]
pub struct Docs {
    /// Name of the type.
    pub name: &'static str,
    /// Doc comment of the type.
    pub text: &'static str,
    /// Fields or variants of the type.
    pub body: DocBody,
}

/// Fields or variants of a type.
#[derive(Debug)]
pub enum DocBody {
    /// Fields of a struct.
    Fields(&'static [DocField]),
    /// Variants of an enum.
    Variants(&'static [DocVariant]),
}

/// Documentation of a field.
#[derive(Debug)]
pub struct DocField {
    /// Name of the field; `_0` for the first of an unnamed list.
    pub name: &'static str,
    /// Doc comment of the field.
    pub text: &'static str,
    /// Whether the field may be omitted.
    pub optional: bool,
    /// Value of an omitted field as JSON; `None` if it is required, or has no fixed default.
    pub default: Option<Value>,
    /// Type of the field.
    pub kind: DocKind,
}

/// Documentation of a variant of an enum.
#[derive(Debug)]
pub struct DocVariant {
    /// Name of the variant.
    pub name: &'static str,
    /// Doc comment of the variant.
    pub text: &'static str,
    /// Whether its fields have names.
    pub named: bool,
    /// Fields of the variant.
    pub fields: &'static [DocField],
}

impl DocKind {
    /// Returns the documentation of a struct or enum, also inside an `Option`; `None` for other types.
    pub fn docs(&self) -> Option<&'static Docs> {
        match self {
            Self::Of(docs) => Some(docs),
            Self::Optional(inner) => inner.docs(),
            _ => None,
        }
    }

    /// Describes the type in words: `number`, `list of Pruner`, `path or None`.
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
    /// Returns the documentation of a type. Each type is read once and stays in memory.
    pub fn of<T: JsonSchema>() -> &'static Self {
        static READ: Mutex<BTreeMap<Cow<'static, str>, &'static Docs>> = Mutex::new(BTreeMap::new());
        let types_read = || READ.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(docs) = types_read().get(&T::schema_id()) {
            return docs;
        }
        let schema = SchemaGenerator::default().into_root_schema_for::<T>().to_value();
        let none = Map::new();
        let types = schema.get("$defs").and_then(Value::as_object).unwrap_or(&none);
        let docs = Reader { types }.docs(&T::schema_name(), &schema);
        types_read().insert(T::schema_id(), docs);
        docs
    }

    /// Returns the fields of a struct; none for an enum.
    pub fn fields(&self) -> &'static [DocField] {
        match self.body {
            DocBody::Fields(fields) => fields,
            DocBody::Variants(_) => &[],
        }
    }

    /// Returns the field `name` of a struct, or of variant `variant` of an enum; `None` if there is none.
    pub fn field(&self, variant: Option<&str>, name: &str) -> Option<&'static DocField> {
        let fields = match self.body {
            DocBody::Fields(fields) => fields,
            DocBody::Variants(variants) => variants.iter().find(|v| Some(v.name) == variant)?.fields,
        };
        fields.iter().find(|field| field.name == name)
    }
}

/// Reader of schemas that refer to `types` by name.
struct Reader<'a> {
    types: &'a Map<String, Value>,
}

impl Reader<'_> {
    /// Returns the documentation of the type `name`.
    fn docs(&self, name: &str, schema: &Value) -> &'static Docs {
        let variants = match schema.get("oneOf").and_then(Value::as_array) {
            Some(schemas) => Some(schemas.iter().flat_map(|schema| self.variants(schema)).collect()),
            None => schema.get("enum").is_some().then(|| self.variants(schema)),
        };
        let body = match variants {
            Some(variants) => DocBody::Variants(variants.leak()),
            None => DocBody::Fields(self.fields(schema)),
        };
        Box::leak(Box::new(Docs { name: leak(name), text: description(schema), body }))
    }

    /// Returns the variants that one schema of an enum represents.
    fn variants(&self, schema: &Value) -> Vec<DocVariant> {
        let text = description(schema);
        let plain = |name: &str| DocVariant { name: leak(name), text, named: false, fields: &[] };
        if let Some(names) = schema.get("enum").and_then(Value::as_array) {
            return names.iter().filter_map(Value::as_str).map(plain).collect();
        }
        if let Some(name) = schema.get("const").and_then(Value::as_str) {
            return vec![plain(name)];
        }
        let variants = schema.get("properties").and_then(Value::as_object);
        let with_fields = |(name, content): (&String, &Value)| {
            let named = content.get("properties").is_some();
            // The schema of a single unnamed field stands for the variant.
            let unnamed = match content.get("prefixItems").and_then(Value::as_array) {
                Some(items) => &items[..],
                None => std::slice::from_ref(content),
            };
            let field = |(i, item)| self.field(&format!("_{i}"), item, false);
            let fields = if named {
                self.fields(content)
            } else {
                unnamed.iter().enumerate().map(field).collect::<Vec<_>>().leak()
            };
            DocVariant { name: leak(name), text, named, fields }
        };
        variants.into_iter().flatten().map(with_fields).collect()
    }

    /// Returns the fields of a struct, or of a variant with names.
    fn fields(&self, schema: &Value) -> &'static [DocField] {
        let required: Vec<&str> =
            schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str).collect();
        let properties = schema.get("properties").and_then(Value::as_object).into_iter().flatten();
        let field = |(name, schema): (&String, &Value)| self.field(name, schema, !required.contains(&&name[..]));
        properties.map(field).collect::<Vec<_>>().leak()
    }

    /// Returns the documentation of one field.
    fn field(&self, name: &str, schema: &Value, optional: bool) -> DocField {
        let default = schema.get("default").cloned();
        DocField { name: leak(name), text: description(schema), optional, default, kind: self.kind(schema) }
    }

    /// Returns the type of a schema.
    fn kind(&self, schema: &Value) -> DocKind {
        let nullable = schema["type"].as_array().is_some_and(|types| types.contains(&"null".into()));
        if nullable { DocKind::Optional(Box::new(self.inner_kind(schema))) } else { self.inner_kind(schema) }
    }

    /// Returns the type of a schema without `None`.
    fn inner_kind(&self, schema: &Value) -> DocKind {
        // The title of a type, such as `Elevation`, describes its notation in words.
        if let Some(words) = schema.get("title").and_then(Value::as_str) {
            return DocKind::Plain(leak(words));
        }
        if let Some(name) = schema.get("$ref").and_then(Value::as_str) {
            let name = name.rsplit('/').next().unwrap_or_default();
            let referenced = &self.types[name];
            return if referenced.get(PLUGINS).is_some() {
                DocKind::Plugin(leak(name))
            } else {
                DocKind::Of(self.docs(name, referenced))
            };
        }
        if let Some([inner, _null]) = schema.get("anyOf").and_then(Value::as_array).map(Vec::as_slice) {
            return DocKind::Optional(Box::new(self.kind(inner)));
        }
        let kind = match &schema["type"] {
            Value::Array(types) => &types[0],
            kind => kind,
        };
        let content = |key: &str| self.kind(&schema[key]);
        match (kind.as_str().unwrap_or_default(), schema.get("prefixItems"), schema.get("minItems")) {
            ("array", Some(Value::Array(items)), _) => {
                DocKind::Tuple(items.iter().map(|item| self.kind(item)).collect())
            }
            // An array of fixed length.
            ("array", _, Some(length)) => DocKind::Tuple(vec![content("items"); length.as_u64().unwrap_or(1) as usize]),
            ("array", ..) => DocKind::List(Box::new(content("items"))),
            ("object", ..) => DocKind::Map(Box::new(content("additionalProperties"))),
            ("boolean", ..) => DocKind::Plain("true or false"),
            ("integer", ..) => DocKind::Plain("whole number"),
            ("number", ..) => DocKind::Plain("number"),
            ("string", ..) if schema["format"] == "path" => DocKind::Plain("path"),
            ("string", ..) => DocKind::Plain("text"),
            _ => DocKind::Plain("value"),
        }
    }
}

/// Keyword of a schema whose variants are all plugins of a kind.
pub(crate) const PLUGINS: &str = "x-plugins";

/// Returns the doc comment in a schema; empty without one.
fn description(schema: &Value) -> &'static str {
    leak(schema.get("description").and_then(Value::as_str).unwrap_or_default().trim())
}

/// Copies a text to memory that is never freed: documentation lives as long as the program.
fn leak(text: &str) -> &'static str {
    Box::leak(text.into())
}
