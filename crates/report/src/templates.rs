//! Templates of everything that is read as a page, with one escaper for each kind of file.

mod latex;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use minijinja::syntax::SyntaxConfig;
use minijinja::value::Value;
use minijinja::{AutoEscape, Environment, escape_formatter};
use pwrfgs_core::{Error, Result};
use pwrfgs_experiment::clock::duration;
use pwrfgs_experiment::text::grouped;
use std::sync::LazyLock;

const TEMPLATES: [(&str, &str); 9] = [
    ("style.css", include_str!("templates/style.css")),
    ("run.html", include_str!("templates/run.html")),
    ("report.html", include_str!("templates/report.html")),
    ("report.md", include_str!("templates/report.md")),
    ("report.tex", include_str!("templates/report.tex")),
    ("table.tex", include_str!("templates/table.tex")),
    ("figures.txt", include_str!("templates/figures.txt")),
    ("lead.txt", include_str!("templates/lead.txt")),
    ("legend.txt", include_str!("templates/legend.txt")),
];

static ENVIRONMENT: LazyLock<Environment<'static>> = LazyLock::new(|| {
    let mut environment = Environment::new();
    // A line that holds nothing but a tag leaves nothing behind.
    let lines = SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).keep_trailing_newline(true).build();
    environment.set_syntax(lines.expect("no delimiters are changed"));
    environment.set_auto_escape_callback(|name| match name.rsplit('.').next() {
        Some("html") => AutoEscape::Html,
        Some("txt") | None => AutoEscape::None,
        Some(other) => AutoEscape::Custom(other.to_owned().into()),
    });
    environment.set_formatter(|out, state, value| {
        let text = match state.auto_escape() {
            AutoEscape::Custom(_) if value.is_safe() => value.to_string(),
            AutoEscape::Custom(kind) if kind == "md" => markdown(&value.to_string()),
            AutoEscape::Custom(kind) if kind == "tex" => latex::escaped(&value.to_string()),
            _ => return escape_formatter(out, state, value),
        };
        Ok(out.write_str(&text)?)
    });
    // A picture inside a page, as an image of its own.
    environment.add_filter("base64", |text: &str| STANDARD.encode(text));
    environment.add_filter("duration", duration);
    environment.add_filter("grouped", |number: f64| grouped(number.round() as i64));
    for (name, text) in TEMPLATES {
        environment.add_template(name, text).expect("templates are right, as tests check");
    }
    environment
});

/// Fills a template in.
pub(crate) fn render(name: &str, context: Value) -> Result<String> {
    let filled = ENVIRONMENT.get_template(name).and_then(|template| template.render(context));
    filled.map_err(|e| Error::Config(format!("the template {name}: {e:#}")))
}

/// Sentences of a template of ours, one a line.
pub(crate) fn sentences(name: &str, context: Value) -> Vec<String> {
    let text = render(name, context).expect("its context is complete, as tests check");
    text.lines().map(str::to_owned).collect()
}

/// Text that Markdown takes as it is, in a table too.
fn markdown(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '\n' | '\r' => out.push(' '),
            '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '|' | '#' | '&' | '~' | '$' => out.extend(['\\', c]),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_in_a_label_is_markup() {
        assert_eq!(markdown("a_b|c*d <i> [x](y)\n#1"), "a\\_b\\|c\\*d \\<i\\> \\[x\\](y) \\#1");
    }
}
