//! Text that stays text, whatever it holds: names and labels come from files that anybody may have written.

/// The letter, or a sign in its place where it would not show: control characters, those that turn the direction of
/// what follows, and those that XML forbids.
fn shown(c: char) -> char {
    let hidden =
        c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{fffe}' | '\u{ffff}');
    if hidden { '\u{fffd}' } else { c }
}

/// On one line, without anything that a terminal obeys.
pub fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_whitespace() { ' ' } else { shown(c) }).collect()
}

/// In XML and HTML, between tags and in quoted attributes alike. Lines stay lines.
pub fn xml(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(c),
            c => out.push(shown(c)),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_ends_an_attribute_or_begins_a_tag() {
        assert_eq!(
            xml("\"/><a href='x'> & \u{1b}[2J\n\0"),
            "&quot;/&gt;&lt;a href=&#39;x&#39;&gt; &amp; \u{fffd}[2J\n\u{fffd}"
        );
        assert_eq!(xml("λ = 0,1 – 模"), "λ = 0,1 – 模");
    }

    #[test]
    fn a_terminal_gets_one_line_and_no_commands() {
        assert_eq!(plain("a\r\nb\t\u{1b}]0;x\u{7}\u{9b}1m\u{202e}c"), "a  b \u{fffd}]0;x\u{fffd}\u{fffd}1m\u{fffd}c");
    }
}
