//! Words of others, as they are shown: what a file says may hold anything, and reaches a terminal or a page.

/// Longest token that a message quotes, characters.
const TOKEN: usize = 60;
/// Longest message, characters: what is longer repeats a file.
const MESSAGE: usize = 2_000;

/// A name without control characters, which could steer a terminal, on one line; and without marks that turn the
/// direction of writing.
pub fn clean(name: &str) -> String {
    let is_plain = |c: char| !c.is_control() && !matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    name.chars().map(|c| if is_plain(c) { c } else { ' ' }).collect::<String>().trim().to_owned()
}

/// A token of a file between backticks, cut to 60 characters.
pub fn quoted(token: &str) -> String {
    let (cut, is_cut) = first(token, TOKEN);
    format!("`{}{}`", clean(cut), if is_cut { " .." } else { "" })
}

/// A message, cut to 2,000 characters.
pub fn bounded(message: String) -> String {
    match first(&message, MESSAGE) {
        (cut, true) => format!("{cut} .."),
        _ => message,
    }
}

/// The first `most` characters, and whether there are more.
fn first(text: &str, most: usize) -> (&str, bool) {
    text.char_indices().nth(most).map_or((text, false), |(end, _)| (&text[..end], true))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_steers_a_terminal_and_nothing_is_endless() {
        assert_eq!(clean("s23"), "s23");
        assert_eq!(clean("a\x1b[31mb\n\u{9b}c\u{202e}"), "a [31mb  c");
        assert_eq!(quoted("x"), "`x`");
        assert_eq!(quoted("a\x07b"), "`a b`");
        assert_eq!(quoted(&"é".repeat(5_000_000)), format!("`{} ..`", "é".repeat(60)));
        assert_eq!(bounded("é".repeat(2_000)).chars().count(), 2_000);
        assert_eq!(bounded("é".repeat(5_000_000)).chars().count(), 2_003);
    }
}
