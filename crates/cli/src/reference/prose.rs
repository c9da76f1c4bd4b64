//! Doc comments as plain text: without code examples, links as names.

use std::fmt::Write as _;

/// Splits a doc comment into paragraphs without code examples, each in one line. Entries of lists and lines of tables are
/// paragraphs.
pub(crate) fn split_paragraphs(text: &str) -> Vec<String> {
    let mut paragraphs: Vec<String> = Vec::new();
    let (mut is_code, mut is_open) = (false, false);
    for line in text.lines() {
        if line.starts_with("```") {
            is_code = !is_code;
            is_open = false;
        } else if !is_code && line.is_empty() {
            is_open = false;
        } else if !is_code {
            let is_block = ["|", "* ", "- ", "#"].iter().any(|start| line.starts_with(start));
            match paragraphs.last_mut() {
                Some(last) if is_open && !is_block => {
                    last.push(' ');
                    last.push_str(line.trim());
                }
                _ => paragraphs.push(line.trim().trim_start_matches("# ").to_owned()),
            }
            is_open = !line.starts_with('|');
        }
    }
    paragraphs.iter().map(|paragraph| without_links(paragraph)).collect()
}

/// Returns the first sentence of a doc comment, without full stop.
pub(crate) fn first_sentence(text: &str) -> String {
    let first = split_paragraphs(text).into_iter().next().unwrap_or_default();
    break_sentences(&first).lines().next().unwrap_or_default().trim_end_matches('.').to_owned()
}

/// Joins the paragraphs of a doc comment into one line.
pub(crate) fn single_line(text: &str) -> String {
    split_paragraphs(text).join(" ")
}

/// Breaks text into one sentence per line. A sentence ends with a full stop before a capital or a code span, except
/// after common abbreviations.
pub(crate) fn break_sentences(text: &str) -> String {
    let mut out = String::new();
    let mut words = text.split(' ').peekable();
    while let Some(word) = words.next() {
        out.push_str(word);
        let begins = words.peek().is_some_and(|next| next.starts_with(|c: char| c.is_uppercase() || c == '`'));
        let ends = word.ends_with('.') && !["e.g.", "i.e.", "eq.", "eqs.", "al."].contains(&word);
        out.push_str(if words.peek().is_none() {
            ""
        } else if ends && begins {
            "\n"
        } else {
            " "
        });
    }
    out
}

/// Replaces the links in a doc comment by the last part of their names: `` [`crate::TopK`](..) `` by `` `TopK` ``.
fn without_links(text: &str) -> String {
    let mut plain = String::new();
    let mut remaining = text;
    while let Some((before, link)) = remaining.split_once("[`") {
        let Some((name, after)) = link.split_once("`]") else { break };
        let name = name.rsplit("::").next().unwrap_or(name);
        _ = write!(plain, "{before}`{name}`");
        remaining = match after.strip_prefix('(').and_then(|a| a.split_once(')')) {
            Some((_, after)) => after,
            None => after,
        };
    }
    plain + remaining
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doc_comments_become_prose() {
        let text = "One [`crate::TopK`] of\ntwo [`Random`](x::Random).\n\n```\nlet a;\n```\n\n| a |\n| b |";
        assert_eq!(split_paragraphs(text), ["One `TopK` of two `Random`.", "| a |", "| b |"]);
    }
}
