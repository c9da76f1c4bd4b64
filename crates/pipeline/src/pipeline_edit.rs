//! `PipelineEdit`: an editable pipeline in text form. Changes are text edits, so every value can be set at any depth without
//! loss. After all changes, the text passes the same parser and checks as a file.

use crate::changes::Change;
use crate::pipeline::Pipeline;
use crate::read::{TextFault, TypeHint};
use crate::ron_tree::RonTree;
use crate::setting::{Setting, TextEdit, path_values, quoted};
use pwrfgs_core::docs::{DocKind, Docs};
use pwrfgs_core::plugin::{ron_options, try_to_ron};
use pwrfgs_core::{Error, Result};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Pipeline under change.
#[derive(Clone, Debug)]
pub struct PipelineEdit {
    text: String,
    changes: Vec<Change>,
}

/// Problem of a draft, and the changes that caused it.
#[derive(Debug)]
pub struct EditFault {
    message: String,
    blamed: Vec<Change>,
}

impl PipelineEdit {
    /// Creates an edit of the text of a pipeline, without changes.
    ///
    /// # Errors
    /// As [`Pipeline::to_ron`].
    pub fn of(pipeline: &Pipeline) -> Result<Self> {
        Ok(Self { text: pipeline.to_ron()?, changes: Vec::new() })
    }

    /// Applies a change. A value without a name, such as `(steps: 500, batch: 2)`, changes only the fields that it contains,
    /// and so does a value of settings, such as those of `training`. All other values replace the old value.
    ///
    /// # Errors
    /// An unknown path or field, or a value that is not RON. [`Self::finish`] checks whether the value fits.
    pub fn set(&mut self, change: &Change) -> Result<(), EditFault> {
        let tree = self.parse_tree();
        let edits = text_edits(&tree, change).map_err(|message| EditFault { message, blamed: vec![change.clone()] })?;
        self.apply(edits);
        self.changes.push(change.clone());
        // Writes the defaults, so that the next change finds their fields.
        let read = ron_options().from_str(&self.text).ok();
        if let Some(Ok(text)) = read.map(|pipeline: Pipeline| pipeline.to_ron()) {
            self.text = text;
        }
        Ok(())
    }

    /// Replaces each path in the pipeline by its result of `absolute`.
    ///
    /// # Errors
    /// A path that is not valid text.
    pub fn rebase(&mut self, absolute: &dyn Fn(&Path) -> PathBuf) -> Result<(), EditFault> {
        let tree = self.parse_tree();
        let absolute_edit = |path: &RonTree| {
            let old: PathBuf = ron_options().from_str(path.text_in(&self.text)).map_err(|e| e.code.to_string())?;
            Ok((path.span.clone(), try_to_ron(&absolute(&old))?))
        };
        let settings = path_values(&DocKind::Of(Docs::of::<Pipeline>()), &tree, &self.text);
        let edits: Result<Vec<TextEdit>, (usize, String)> = settings
            .into_iter()
            .map(|path| absolute_edit(path).map_err(|why: String| (path.span.start, why)))
            .collect();
        let fault = |(at, message)| self.blame(TextFault { message, at: Some(at), hint: TypeHint::Never });
        self.apply(edits.map_err(fault)?);
        Ok(())
    }

    /// Returns the validated pipeline.
    ///
    /// # Errors
    /// The pipeline is invalid: its first problem, with the changes that caused it.
    pub fn finish(&self) -> Result<Pipeline, EditFault> {
        Pipeline::parse_with_fault(&self.text).map_err(|fault| self.blame(fault))
    }

    /// Returns the fault of a `field`, with the changes that caused it.
    pub fn field_fault(&self, field: &str, message: String) -> EditFault {
        self.blame(TextFault::of(field, message, &self.parse_tree()))
    }

    /// Returns a fault of the text with the changes that caused it: those inside the smallest value around its position
    /// that contains a change. For a single change, the message adds the type of its value if `hint` asks for it.
    fn blame(&self, fault: TextFault) -> EditFault {
        let TextFault { mut message, at, hint } = fault;
        let tree = self.parse_tree();
        let settings: Vec<Option<Setting<'_>>> =
            self.changes.iter().map(|c| Setting::at(&c.path, &tree).ok()).collect();
        let spans: Vec<Option<Range<usize>>> =
            settings.iter().map(|setting| Some(setting.as_ref()?.tree.span.clone())).collect();
        let inside = |outer: &Range<usize>| -> Vec<usize> {
            let is_inside = |span: &Range<usize>| outer.start <= span.start && span.end <= outer.end;
            // The later of two changes at one path applies.
            let is_last = |k: usize| !spans[k + 1..].contains(&spans[k]);
            (0..spans.len()).filter(|&k| spans[k].as_ref().is_some_and(is_inside) && is_last(k)).collect()
        };
        let around = at.map_or_else(|| vec![tree.span.clone()], |at| tree.ranges_around(at));
        let blamed = around.iter().map(inside).find(|blamed| !blamed.is_empty()).unwrap_or_default();
        if let [only] = blamed[..]
            && let Some(Setting { tree, kind: Some(kind), .. }) = &settings[only]
            && at.is_some_and(|at| (tree.span.start..=tree.span.end).contains(&at))
            && (hint == TypeHint::Always
                || hint == TypeHint::AtLeaf && tree.fields().is_empty() && tree.items().is_empty())
        {
            // Replaces messages on the position where the parser stopped: the user set one value.
            let stopped = ["Expected comma", "Expected opening", "Expected identifier", "Integer is out of bounds"];
            if stopped.iter().any(|start| message.starts_with(start)) {
                message = "invalid value".into();
            }
            message = format!("{message}; it takes a {}", kind.words());
        }
        EditFault { message, blamed: blamed.into_iter().map(|k| self.changes[k].clone()).collect() }
    }

    /// Parses the text of the pipeline.
    fn parse_tree(&self) -> RonTree {
        RonTree::parse(&self.text).expect("text written by the program and parsed edits are valid values")
    }

    /// Applies text edits from the last to the first, so that the ranges of the others stay valid.
    fn apply(&mut self, mut edits: Vec<TextEdit>) {
        edits.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
        edits.into_iter().for_each(|(span, text)| self.text.replace_range(span, &text));
    }
}

/// Returns the edits of the text of `tree` that set the value of `change`.
///
/// # Errors
/// The path or a field of the value is unknown, or the value is not RON.
fn text_edits(tree: &RonTree, change: &Change) -> Result<Vec<TextEdit>, String> {
    let setting = Setting::at(&change.path, tree)?;
    let value = setting.complete_value(change.value.trim());
    let new = RonTree::parse(&value).map_err(|why| format!("{} is not a value: {why}", quoted(change.value.trim())))?;
    let mut edits = Vec::new();
    setting.replace(&new, &value, &mut edits)?;
    Ok(edits)
}

impl EditFault {
    /// Converts to an error without a file position.
    pub fn in_arguments(self) -> Error {
        Error::Config(self.to_string())
    }

    /// Converts to an error of the file at `path` if that contains a blamed change or no change is blamed, otherwise without a
    /// file.
    pub fn in_file(self, path: &Path) -> Error {
        let at = self.blamed.iter().rev().find_map(|change| change.at);
        if at.is_none() && !self.blamed.is_empty() {
            return self.in_arguments();
        }
        let message = self.to_string();
        Error::Input { path: path.into(), at, message }
    }
}

/// Names of the responsible changes without repetition, and the problem.
impl std::fmt::Display for EditFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut names: Vec<&str> = self.blamed.iter().map(|change| change.name.as_str()).collect();
        names.dedup();
        let colon = if names.is_empty() { "" } else { ": " };
        write!(f, "{}{colon}{}", names.join(" and "), self.message)
    }
}

impl Pipeline {
    /// Applies all `changes` or none, and validates the result once.
    ///
    /// # Errors
    /// [`Error::Config`] if a path is unknown, a value is invalid, or the result does not fit together; the message
    /// names the changes to blame.
    pub fn change(&mut self, changes: &[Change]) -> Result<()> {
        let mut draft = PipelineEdit::of(self)?;
        let changed = changes.iter().try_for_each(|change| draft.set(change)).and_then(|()| draft.finish());
        *self = changed.map_err(EditFault::in_arguments)?;
        Ok(())
    }

    /// Returns the pipeline with its paths mapped by `absolute`.
    ///
    /// # Errors
    /// [`Error::Config`] if the pipeline is invalid, or a path is not valid text.
    pub fn rebased(&self, absolute: &dyn Fn(&Path) -> PathBuf) -> Result<Self> {
        let mut draft = PipelineEdit::of(self)?;
        draft.rebase(absolute).and_then(|()| draft.finish()).map_err(EditFault::in_arguments)
    }

    /// Applies `--set` arguments, such as `training.steps=1000` or `pruners.LearnableMask.lambda=0.05`.
    ///
    /// # Errors
    /// Same as [`Self::change`].
    pub fn set_all<S: AsRef<str>>(&mut self, arguments: &[S]) -> Result<()> {
        let changes: Result<Vec<Change>> =
            arguments.iter().map(|argument| Change::parse_argument(argument.as_ref())).collect();
        self.change(&changes?)
    }

    /// Applies one `--set` argument, see [`Self::set_all`].
    ///
    /// # Errors
    /// Same as [`Self::set_all`].
    pub fn set(&mut self, argument: &str) -> Result<()> {
        self.set_all(&[argument])
    }
}
