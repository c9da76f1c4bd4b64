//! What the comments in the source say, at hand while the program runs: the one origin of `pwrfgs plugins`
//! and of the comments in a pipeline that `pwrfgs init` writes.
//!
//! A type that derives [`Documented`] hands over its doc comments. That is all it takes: a plugin is then found by its
//! [`TypeId`], and what its fields are made of by their types.

use crate::plugin::{Checked, Plugin, PluginKind};
pub use pwrfgs_macros::Documented;
use std::any::TypeId;
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::path::PathBuf;

/// A type that can say what it is. `#[derive(Documented)]` does it for a struct or enum with serde's derives.
pub trait Documented {
    /// What values of this type are.
    fn kind() -> Kind;
}

/// What may stand in a place.
#[derive(Clone, Debug)]
pub enum Kind {
    /// A plain value, in words, such as `number`.
    Plain(&'static str),
    /// A struct or enum that is documented.
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
    pub kind: fn() -> Kind,
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

/// A documented type by its [`TypeId`]; the derive submits it.
#[derive(Debug)]
pub struct Entry {
    /// Which type.
    pub of: TypeId,
    /// What it says.
    pub kind: fn() -> Kind,
}
inventory::collect!(Entry);

/// What a type says, where it derives [`Documented`].
pub fn docs_of(of: TypeId) -> Option<&'static Docs> {
    inventory::iter::<Entry>().find(|entry| entry.of == of).and_then(|entry| (entry.kind)().docs())
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

macro_rules! plain {
    ($($words:literal: $($type:ty),+;)+) => {
        $($(impl Documented for $type { fn kind() -> Kind { Kind::Plain($words) } })+)+
    };
}
plain! {
    "true or false": bool;
    "number": f32, f64;
    "whole number": i8, i16, i32, i64, isize, u8, u16, u32, u64, usize;
    "text": String;
    "path": PathBuf;
    "two numbers": crate::Elevation;
}

impl<T: ?Sized + PluginKind> Documented for Plugin<T> {
    fn kind() -> Kind {
        Kind::Plugin(T::KIND)
    }
}

impl<T: Documented> Documented for Checked<T> {
    fn kind() -> Kind {
        T::kind()
    }
}

impl<T: Documented> Documented for Option<T> {
    fn kind() -> Kind {
        Kind::Optional(Box::new(T::kind()))
    }
}

impl<T: Documented> Documented for Vec<T> {
    fn kind() -> Kind {
        Kind::List(Box::new(T::kind()))
    }
}

impl<T: Documented, const N: usize> Documented for [T; N] {
    fn kind() -> Kind {
        Kind::Tuple(vec![T::kind(); N])
    }
}

impl<A: Documented, B: Documented> Documented for (A, B) {
    fn kind() -> Kind {
        Kind::Tuple(vec![A::kind(), B::kind()])
    }
}

impl<T: Documented> Documented for BTreeMap<String, T> {
    fn kind() -> Kind {
        Kind::Map(Box::new(T::kind()))
    }
}

/// The type of a field, for the derive: its own [`Kind`] where it is documented, else its name. An inherent method wins over
/// that of a trait, and exists for documented types only.
#[derive(Debug)]
pub struct Of<T>(&'static str, PhantomData<T>);

impl<T> Of<T> {
    /// The type that the source calls `words`.
    pub fn new(words: &'static str) -> Self {
        Self(words, PhantomData)
    }
}

impl<T: Documented> Of<T> {
    /// What values of this type are.
    pub fn kind(&self) -> Kind {
        T::kind()
    }
}

/// See [`Of`].
pub trait Undocumented {
    /// The name of a type that is not documented.
    fn kind(&self) -> Kind;
}

impl<T> Undocumented for Of<T> {
    fn kind(&self) -> Kind {
        Kind::Plain(self.0)
    }
}
