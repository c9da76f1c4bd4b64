//! `pwrfgs plugins`: every linked plugin with its fields and defaults, written as a pipeline would have it.

use crate::output;
use clap::Args;
use pwrfgs_core::plugin::{PluginKind, ron_options};
use pwrfgs_core::{
    Baseline, DataSource, Deformation, Error, Initializer, Metric, Plugin, Projector, Pruner, Rasterizer, Result,
    Split, did_you_mean, registered,
};
use std::fmt::Write as _;
use std::process::ExitCode;

/// A family of plugins.
struct Kind {
    name: &'static str,
    /// The pipeline's field that takes it.
    field: &'static str,
    plugins: Vec<Entry>,
}

struct Entry {
    name: &'static str,
    about: &'static str,
    /// The plugin with its defaults, as RON, or why it has none.
    text: String,
}

#[derive(Debug, Args)]
pub(crate) struct Plugins {
    /// Only this plugin, or all of this kind (such as Pruner)
    #[arg(value_name = "NAME")]
    pub(crate) name: Option<String>,
}

pub(crate) fn plugins(arguments: &Plugins) -> Result<ExitCode> {
    let kinds = all();
    let mut out = String::new();
    let wanted = arguments.name.as_deref().map(str::to_lowercase);
    for kind in &kinds {
        let whole = wanted.as_ref().is_none_or(|w| *w == kind.name.to_lowercase() || w == kind.field);
        let chosen = |e: &&Entry| whole || wanted.as_ref().is_some_and(|w| *w == e.name.to_lowercase());
        let mut entries = kind.plugins.iter().filter(chosen).peekable();
        if entries.peek().is_some() {
            _ = writeln!(out, "{} (field `{}`)", kind.name, kind.field);
        }
        for entry in entries {
            _ = write!(out, "  {}", entry.name);
            _ = writeln!(out, "{}{}", if entry.about.is_empty() { "" } else { ": " }, entry.about);
            entry.text.lines().for_each(|line| _ = writeln!(out, "      {line}"));
        }
    }
    if out.is_empty() {
        return Err(unknown(arguments.name.as_deref().unwrap_or_default(), &kinds));
    }
    output::result(&out)?;
    Ok(ExitCode::SUCCESS)
}

/// Every family, in the order of a pipeline's fields.
fn all() -> Vec<Kind> {
    vec![
        kind::<dyn DataSource>("data"),
        kind::<dyn Split>("split"),
        kind::<dyn Initializer>("initializer"),
        kind::<dyn Projector>("projector"),
        kind::<dyn Rasterizer>("rasterizer"),
        kind::<dyn Deformation>("deformation"),
        kind::<dyn Pruner>("pruners"),
        kind::<dyn Baseline>("baselines"),
        kind::<dyn Metric>("metrics"),
    ]
}

fn kind<T: ?Sized + PluginKind>(field: &'static str) -> Kind
where
    Box<T>: for<'de> serde::Deserialize<'de>,
    Plugin<T>: serde::Serialize,
{
    let config = || ron::ser::PrettyConfig::new().struct_names(true).depth_limit(3).indentor("    ");
    let describe = |name: &'static str| match Plugin::<T>::parse(&format!("{name}()")) {
        Ok(plugin) => Entry {
            name,
            about: plugin.about_plugin(),
            text: ron_options().to_string_pretty(&plugin, config()).unwrap_or_else(|e| e.to_string()),
        },
        Err(why) => Entry { name, about: "", text: format!("(not without fields: {why})") },
    };
    Kind { name: T::KIND, field, plugins: registered::<T>().into_iter().map(describe).collect() }
}

/// No such plugin; the nearest name helps.
fn unknown(name: &str, kinds: &[Kind]) -> Error {
    let names = kinds.iter().flat_map(|k| k.plugins.iter().map(|e| e.name).chain([k.name]));
    let hint = did_you_mean(name, names);
    Error::Config(format!("no plugin and no kind of plugins is called `{name}`{hint} (`pwrfgs plugins` lists all)"))
}
