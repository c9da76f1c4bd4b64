//! What is linked into this program, kind by kind.

use super::{Plugin, PluginKind, read_ron, registered, to_ron};
use crate::Result;
use crate::docs::Docs;
use serde::Deserialize;
use std::path::Path;

/// A family of plugins, whatever its trait.
#[derive(Debug)]
pub struct Family {
    /// The trait's name, such as `Pruner`.
    pub kind: &'static str,
    /// All of it that are linked into this program, sorted by name.
    pub members: fn() -> Vec<Member>,
    /// A plugin of this kind with every default written out.
    ///
    /// # Errors
    /// As [`read_ron`], with the position in the text.
    pub complete: fn(&str) -> Result<String>,
    /// What the source says of the plugin in a text of this kind; nothing if the text is none.
    pub docs: fn(&str) -> Option<&'static Docs>,
}
inventory::collect!(Family);

/// One plugin.
#[derive(Clone, Debug)]
pub struct Member {
    /// Its name.
    pub name: &'static str,
    /// What its source says; nothing where it has no defaults.
    pub docs: Option<&'static Docs>,
    /// The plugin with its defaults as RON, or why it has none.
    pub text: std::result::Result<String, String>,
}

impl Family {
    /// That of `T`.
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

    /// That of this kind, where there is one.
    pub fn find(kind: &str) -> Option<&'static Self> {
        inventory::iter::<Self>().find(|family| family.kind == kind)
    }
}

fn members<T: ?Sized + PluginKind + erased_serde::Serialize>() -> Vec<Member>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    let describe = |name| match Plugin::<T>::parse(&format!("{name}()")) {
        Ok(plugin) => Member { name, docs: Some(plugin.get().docs()), text: Ok(to_ron(&plugin)) },
        Err(why) => Member { name, docs: None, text: Err(why) },
    };
    registered::<T>().into_iter().map(describe).collect()
}
