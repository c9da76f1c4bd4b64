//! Sanitised display of foreign text: file contents may hold control characters and reach a terminal or a web page.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::path::Path;

/// First characters of spreadsheet formulas.
const FORMULA: [char; 4] = ['=', '+', '-', '@'];
/// Maximum length of a quoted token, characters.
const TOKEN: usize = 60;
/// Maximum length of a message, characters; longer messages repeat a file. The end, with the next step, is kept.
const MESSAGE: usize = 1_200;
/// Number of characters kept at the end of such a message.
const END: usize = 400;
/// Longest number in a message, digits before its point; longer ones are written as powers of ten.
const DIGITS: usize = 30;

/// Joins the first `most` names by commas, followed by the number of the others.
pub fn join_names<T: AsRef<str>>(names: impl ExactSizeIterator<Item = T>, most: usize) -> String {
    let more = names.len().saturating_sub(most);
    let shown = names.take(most).map(|name| name.as_ref().to_owned()).collect::<Vec<_>>().join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

/// Returns a name on one line, without spaces at its ends: control characters, which could change the state of a terminal,
/// and controls of text direction become spaces.
pub fn strip_control(name: &str) -> String {
    name.chars().map(|c| if is_harmless(c) { c } else { ' ' }).collect::<String>().trim().to_owned()
}

/// Returns whether a character is neither a control character nor an embedding, override or isolate of text direction.
fn is_harmless(c: char) -> bool {
    !c.is_control() && !matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Returns a token of a file or a setting between backticks, as [`strip_control`] and cut to 60 characters.
pub fn quoted(token: &str) -> String {
    let (cut, is_cut) = truncate(token, TOKEN);
    format!("`{}{}`", strip_control(cut), if is_cut { " .." } else { "" })
}

/// Returns text for a terminal: newlines and tabs are kept; other control characters, and controls of text direction, become
/// `\u{fffd}`.
pub fn escape_control(text: &str) -> String {
    text.chars().map(|c| if is_harmless(c) || c == '\n' || c == '\t' { c } else { '\u{fffd}' }).collect()
}

/// Returns a message for users, as [`escape_control`], with long numbers as powers of ten. A message of more than 1,200
/// characters, which repeats a file, loses its middle.
pub fn sanitize_message(message: &str) -> String {
    escape_and_shorten(&shorten_numbers(message))
}

/// Returns a path for users, as [`sanitize_message`] without its change of numbers.
pub fn sanitize_path(path: &Path) -> String {
    escape_and_shorten(&path.display().to_string())
}

/// Escapes control characters, and replaces the middle of a message of more than [`MESSAGE`] characters by ` .. `.
fn escape_and_shorten(message: &str) -> String {
    let (start, is_long) = truncate(message, MESSAGE - END);
    let count = if is_long { message.chars().count() } else { 0 };
    if count <= MESSAGE {
        return escape_control(message);
    }
    let end: String = message.chars().skip(count - END).collect();
    escape_control(&format!("{start} .. {end}"))
}

/// Writes numbers of more than [`DIGITS`] digits as powers of ten: `1e300` has 301 digits.
fn shorten_numbers(text: &str) -> Cow<'_, str> {
    let is_digit = |c: char| c.is_ascii_digit();
    let count_digits = |text: &str| text.len() - text.trim_start_matches(is_digit).len();
    let (mut out, mut unread) = (String::new(), text);
    while let Some(start) = unread.find(is_digit) {
        let digits = count_digits(&unread[start..]);
        let decimals = unread[start + digits..].strip_prefix('.').map_or(0, count_digits);
        let end = start + digits + if decimals > 0 { decimals + 1 } else { 0 };
        out.push_str(&unread[..start]);
        match unread[start..end].parse::<f64>() {
            Ok(number) if digits > DIGITS && number.is_finite() => _ = write!(out, "{number:e}"),
            _ => out.push_str(&unread[start..end]),
        }
        unread = &unread[end..];
    }
    if out.is_empty() { text.into() } else { (out + unread).into() }
}

/// Returns text as a cell of a table. Text that begins with `=`, `+`, `-` or `@` is a formula for spreadsheets: it gets
/// the prefix `'`, and so does text that begins with `'`. Numbers have no prefix.
pub fn cell(text: &str) -> Cow<'_, str> {
    let is_formula = || text.starts_with(FORMULA) && text.parse::<f64>().is_err();
    if text.starts_with('\'') || is_formula() { format!("'{text}").into() } else { text.into() }
}

/// Returns the text of a cell, the inverse of [`cell`]: without one `'` at its start.
pub fn text_of(cell: &str) -> &str {
    cell.strip_prefix('\'').unwrap_or(cell)
}

/// Returns the first `most` characters of a text, and whether there are more.
fn truncate(text: &str, most: usize) -> (&str, bool) {
    text.char_indices().nth(most).map_or((text, false), |(end, _)| (&text[..end], true))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_have_exponents() {
        for (text, expected) in [
            (format!("`test` is {}; give less", -1e300), "`test` is -1e300; give less"),
            (format!("{:.2} m and {:.1}", 1.5e300, 2.5), "1.5e300 m and 2.5"),
            (format!("{} of {}.", u64::MAX, 0.1), "18446744073709551615 of 0.1."),
            ("v1.2.3, é 5.".into(), "v1.2.3, é 5."),
        ] {
            assert_eq!(sanitize_message(&text), expected);
        }
        let name = format!("{}.png", "1".repeat(40));
        assert_eq!(sanitize_path(Path::new(&name)), name);
    }

    #[test]
    fn table_cell_round_trips_text_without_formulas() {
        let mut texts = vec![String::new()];
        for _ in 0..4 {
            let longer = texts.iter().flat_map(|text| "'=+-@a1. ".chars().map(move |c| format!("{text}{c}")));
            texts = longer.chain([String::new()]).collect();
        }
        for text in texts {
            assert_eq!(text_of(&cell(&text)), text);
            assert!(!cell(&text).starts_with(FORMULA) || text.parse::<f64>().is_ok(), "{text}");
        }
    }

    #[test]
    fn escapes_control_characters_and_limits_length() {
        assert_eq!(strip_control("s23"), "s23");
        assert_eq!(strip_control("a\x1b[31mb\n\u{9b}c\u{202e}"), "a [31mb  c");
        assert_eq!(quoted("x"), "`x`");
        assert_eq!(quoted("a\x07b"), "`a b`");
        assert_eq!(quoted(&"é".repeat(5_000_000)), format!("`{} ..`", "é".repeat(60)));
        assert_eq!(
            ["=1+1", "@a", "-x", "a=b", "-0.5", "+1e3", "-inf"].map(cell),
            ["'=1+1", "'@a", "'-x", "a=b", "-0.5", "+1e3", "-inf"]
        );
        assert_eq!(escape_control("s\u{1b}[31m23\r\n\tµ"), "s\u{fffd}[31m23\u{fffd}\n\tµ");
        assert_eq!(sanitize_message(&"é".repeat(1_200)).chars().count(), 1_200);
        let long = sanitize_message(&format!("`{}`; write less", "é".repeat(5_000_000)));
        assert!(long.starts_with("`éé") && long.ends_with("éé`; write less") && long.chars().count() == 1_204);
    }
}
