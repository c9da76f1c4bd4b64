//! Templates of pages and documents, with an escaper per file type.

use crate::canvas::{escape_xml, single_line};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use minijinja::syntax::SyntaxConfig;
use minijinja::value::Value;
use minijinja::{AutoEscape, Environment};
use pwrfgs_core::{Error, Result};
use pwrfgs_experiment::text::{format_duration, grouped};
use std::sync::LazyLock;

const TEMPLATES: [(&str, &str); 16] = [
    ("style.css", include_str!("templates/style.css")),
    ("head.html", include_str!("templates/head.html")),
    ("policy.html", include_str!("templates/policy.html")),
    ("live.html", include_str!("templates/live.html")),
    ("room.html", include_str!("templates/room.html")),
    ("run.html", include_str!("templates/run.html")),
    ("maps.html", include_str!("templates/maps.html")),
    ("powers.html", include_str!("templates/powers.html")),
    ("channels.html", include_str!("templates/channels.html")),
    ("receivers.html", include_str!("templates/receivers.html")),
    ("report.html", include_str!("templates/report.html")),
    ("report.tex", include_str!("templates/report.tex")),
    ("table.tex", include_str!("templates/table.tex")),
    ("figures.txt", include_str!("templates/figures.txt")),
    ("lead.txt", include_str!("templates/lead.txt")),
    ("legend.txt", include_str!("templates/legend.txt")),
];

static ENVIRONMENT: LazyLock<Environment<'static>> = LazyLock::new(|| {
    let mut environment = Environment::new();
    // Lines with only a tag produce no output.
    let lines = SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).keep_trailing_newline(true).build();
    environment.set_syntax(lines.expect("no delimiters are changed"));
    environment.set_auto_escape_callback(|name| match name.rsplit('.').next() {
        Some("html") => AutoEscape::Html,
        Some("txt") | None => AutoEscape::None,
        Some(other) => AutoEscape::Custom(other.to_owned().into()),
    });
    environment.set_formatter(|out, state, value| {
        let text = value.to_string();
        let text = match state.auto_escape() {
            _ if value.is_safe() => text,
            AutoEscape::Html => escape_xml(&text),
            AutoEscape::Custom(kind) if kind == "tex" => escape_tex(&text),
            _ => single_line(&text),
        };
        Ok(out.write_str(&text)?)
    });
    // An image embedded in a page.
    environment.add_filter("base64", |text: &str| STANDARD.encode(text));
    environment.add_filter("duration", format_duration);
    environment.add_filter("grouped", |number: f64| grouped(number.round() as i64));
    for (name, text) in TEMPLATES {
        environment.add_template(name, text).expect("templates are right, as tests check");
    }
    environment
});

/// Renders the built-in template `name`.
///
/// # Errors
/// A filter or an attribute of a missing value. A missing value itself is printed as empty text.
pub(crate) fn render(name: &str, context: Value) -> Result<String> {
    let filled = ENVIRONMENT.get_template(name).and_then(|template| template.render(context));
    filled.map_err(|e| Error::Config(format!("template {name}: {e:#}")))
}

/// Renders a built-in template of plain text as sentences, one per line.
///
/// # Panics
/// If [`render`] returns an error.
pub(crate) fn render_sentences(name: &str, context: Value) -> Vec<String> {
    let text = render(name, context).expect("its context is complete, as tests check");
    text.lines().map(str::to_owned).collect()
}

/// Characters with a meaning in LaTeX and their replacements. Two dashes in a row would become a long dash.
const SIGNS: &str = r#"
    \ \textbackslash{} ~ \textasciitilde{} ^ \textasciicircum{} & \& % \% $ \$ # \# _ \_ { \{ } \} < \textless{}
    > \textgreater{} | \textbar{} " \textquotedbl{} - -{} ' \textquotesingle{} ` \textasciigrave{} / /\allowbreak{}
    [ {[} ] {]}"#;

/// Letters and signs that are available only in math mode.
const SYMBOLS: &str = r"
    − - ± \pm × \times · \cdot ° ^\circ ² ^2 ³ ^3 ∞ \infty ≤ \le ≥ \ge ≈ \approx ≡ \equiv → \rightarrow ↑ \uparrow ↓ \downarrow
    √ \surd ∈ \in Δ \Delta Σ \Sigma Ω \Omega Φ \Phi α \alpha β \beta γ \gamma δ \delta ε \varepsilon η \eta θ \theta
    λ \lambda μ \mu µ \mu ν \nu π \pi ρ \rho σ \sigma τ \tau φ \varphi ψ \psi ω \omega ¹ ^1 ⁻ ^-";

/// Finds the replacement of `c` in a list of words, each character followed by its replacement; `None` if it is not listed.
fn find_replacement(list: &'static str, c: char) -> Option<&'static str> {
    let mut words = list.split_whitespace();
    while let (Some(key), Some(value)) = (words.next(), words.next()) {
        if key.chars().eq([c]) {
            return Some(value);
        }
    }
    None
}

/// Escapes text for LaTeX with T1 fonts and textcomp. Characters that the fonts lack are written as code points.
fn escape_tex(text: &str) -> String {
    let escape = |c: char| match (find_replacement(SIGNS, c), find_replacement(SYMBOLS, c)) {
        (Some(shown), _) => shown.to_owned(),
        (_, Some(symbol)) => format!("\\ensuremath{{{symbol}}}"),
        // Latin-1 and Latin Extended-A but for the few that T1 has no command for.
        _ if (' '..='~').contains(&c) || ('\u{a1}'..='\u{17e}').contains(&c) && !"ĦħĸĿŀŉŦŧ".contains(c) => {
            c.into()
        }
        _ if "–—‘’“”…†‡•".contains(c) => c.into(),
        _ if c.is_whitespace() => " ".into(),
        _ => format!("{{[}}U+{:04X}{{]}}", u32::from(c)),
    };
    text.chars().map(escape).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use minijinja::context;

    #[test]
    fn labels_are_escaped_in_legend() {
        let (name, reference, least, most) = ("differences", "a\nb\u{1b}", 3, 3);
        let words = context! { name, reference, least, most, replicates => 9, percent => 95, edge => "1", cubes => 20 };
        let message = render_sentences("legend.txt", words.clone());
        assert!(message[0].starts_with("Row minus a b\u{fffd}: mean") && message.len() == 4, "{message:#?}");
        assert!(message[1].contains("cubes of 1 m (20 with test"), "{message:#?}");
        let nowhere = context! { edge => None::<String>, observations => "channels", ..words };
        let message = render_sentences("legend.txt", nowhere);
        assert!(message[1].contains("single channels (20), because positions are unknown"), "{message:#?}");
    }

    #[test]
    fn legend_of_ranks_counts_methods_and_seeds() {
        let words = context! { name => "ranks", families => 5, least => 1, most => 3 };
        let message = render_sentences("legend.txt", words);
        assert!(message[0].contains("among the 5 methods") && message[0].contains("1 to 3 seeds"), "{message:#?}");
    }

    #[test]
    fn escapes_every_tex_special_character() {
        let escaped = escape_tex(r"\ { } $ & # ^ _ % ~");
        let expected = r"\textbackslash{} \{ \} \$ \& \# \textasciicircum{} \_ \% \textasciitilde{}";
        assert_eq!(escaped, expected);
        assert_eq!(escape_tex("RT ±20% λ=0.1 --x"), "RT \\ensuremath{\\pm}20\\% \\ensuremath{\\lambda}=0.1 -{}-{}x");
        assert_eq!(escape_tex("«ü» 模"), "«ü» {[}U+6A21{]}");
    }
}
