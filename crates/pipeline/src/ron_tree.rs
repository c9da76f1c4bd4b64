//! RON text as a tree with text positions and field names, for lossless edits and comments. Types, numbers and variant
//! names are validated by the parser.

use std::ops::Range;

/// Largest nesting depth.
const DEEPEST: usize = 100;

/// Value in a text.
#[derive(Clone, Debug, PartialEq)]
pub struct RonTree {
    /// Text range, bytes.
    pub span: Range<usize>,
    /// Name: `Mercator` of `Mercator(blur: 0.3)`, `true` of `true`.
    pub name: Option<String>,
    /// Content of the value.
    pub body: RonBody,
    /// Whether it is a quoted text.
    pub quoted: bool,
}

/// Content of a value.
#[derive(Clone, Debug, PartialEq)]
pub enum RonBody {
    /// Value without parts: a number, a text, a name alone, a map.
    Plain,
    /// Named fields in parentheses.
    Fields(Vec<(String, RonTree)>),
    /// Unnamed values in brackets or parentheses.
    Items(Vec<RonTree>),
}

impl RonTree {
    /// Parses `text` as a single value.
    ///
    /// # Errors
    /// The text is not a single value; the message gives the problem without its position.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut reader = Reader { text, at: 0 };
        reader.skip_attributes()?;
        let tree = reader.parse_value(0)?;
        reader.skip_space()?;
        if reader.at < text.len() { Err(reader.unexpected_fault("the end")) } else { Ok(tree) }
    }

    /// Returns the field called `name`; `None` if there is none.
    pub fn field(&self, name: &str) -> Option<&Self> {
        self.fields().iter().find(|(field, _)| field == name).map(|(_, tree)| tree)
    }

    /// Returns all named fields, or none.
    pub fn fields(&self) -> &[(String, Self)] {
        if let RonBody::Fields(fields) = &self.body { fields } else { &[] }
    }

    /// Returns all unnamed values, or none.
    pub fn items(&self) -> &[Self] {
        if let RonBody::Items(items) = &self.body { items } else { &[] }
    }

    /// Returns the ranges of the keys of a map in `text`, from which this tree was parsed; none for other values. Keys are
    /// not stored, so the map is parsed again.
    pub fn key_spans(&self, text: &str) -> Vec<Range<usize>> {
        let mut reader = Reader { text, at: self.span.start };
        if reader.peek() == Some('{') { reader.parse_map(0).unwrap_or_default() } else { Vec::new() }
    }

    /// Returns the text ranges of the values that contain the byte `at`, smallest first; both ends count.
    pub fn ranges_around(&self, at: usize) -> Vec<Range<usize>> {
        if !(self.span.start..=self.span.end).contains(&at) {
            return Vec::new();
        }
        let parts = self.fields().iter().map(|(_, tree)| tree).chain(self.items());
        let mut ranges = parts.map(|part| part.ranges_around(at)).find(|ranges| !ranges.is_empty()).unwrap_or_default();
        ranges.push(self.span.clone());
        ranges
    }

    /// Returns the text of this value, a part of `text`.
    pub fn text_in<'a>(&self, text: &'a str) -> &'a str {
        &text[self.span.clone()]
    }
}

/// Position in a text that is parsed.
struct Reader<'a> {
    text: &'a str,
    at: usize,
}

impl Reader<'_> {
    /// Returns the text that has not been read.
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    /// Returns the next character without reading it; `None` at the end of the text.
    fn peek(&self) -> Option<char> {
        self.rest().chars().next()
    }

    /// Returns the message for a character at this position that is not `expected`.
    fn unexpected_fault(&self, expected: &str) -> String {
        match self.peek() {
            Some(next) => format!("expected {expected}, found `{}`", next.escape_debug()),
            None => format!("expected {expected}, but the text ends"),
        }
    }

    /// Skips spaces and comments. Returns an error for a comment without its end.
    fn skip_space(&mut self) -> Result<(), String> {
        loop {
            self.at += self.rest().len() - self.rest().trim_start().len();
            if self.rest().starts_with("//") {
                self.at += self.rest().find('\n').unwrap_or(self.rest().len());
            } else if self.rest().starts_with("/*") {
                self.skip_block_comment()?;
            } else {
                return Ok(());
            }
        }
    }

    /// Skips a comment `/* .. */`, which may contain others. Returns an error if it does not end.
    fn skip_block_comment(&mut self) -> Result<(), String> {
        let mut depth = 0;
        loop {
            let (length, deeper) = match self.rest().as_bytes() {
                [b'/', b'*', ..] => (2, 1),
                [b'*', b'/', ..] => (2, -1),
                _ => (self.peek().ok_or("a comment `/*` does not end")?.len_utf8(), 0),
            };
            self.at += length;
            depth += deeper;
            if depth == 0 {
                return Ok(());
            }
        }
    }

    /// Skips `#![enable(..)]` at the start of a file. Returns an error if it does not end.
    fn skip_attributes(&mut self) -> Result<(), String> {
        self.skip_space()?;
        while self.rest().starts_with("#!") {
            self.at += self.rest().find(']').ok_or("an attribute `#![` does not end")? + 1;
            self.skip_space()?;
        }
        Ok(())
    }

    /// Skips `sign`, and returns whether it was there.
    fn take_sign(&mut self, sign: char) -> bool {
        let is_next = self.rest().starts_with(sign);
        self.at += if is_next { sign.len_utf8() } else { 0 };
        is_next
    }

    /// Reads letters, digits, `_` and the characters `further`, such as signs and points of numbers; empty if there are
    /// none. Skips the mark `r#` of a raw name.
    fn read_word(&mut self, further: &str) -> &str {
        let is_raw = self.rest().strip_prefix("r#").is_some_and(|rest| rest.starts_with(char::is_alphabetic));
        self.at += if is_raw { 2 } else { 0 };
        let end = self.rest().find(|c: char| !(c.is_alphanumeric() || c == '_' || further.contains(c)));
        let (from, length) = (self.at, end.unwrap_or(self.rest().len()));
        self.at += length;
        &self.text[from..from + length]
    }

    /// Parses a value of any type. Returns an error for other text, text without its end, and values nested deeper than
    /// [`DEEPEST`].
    fn parse_value(&mut self, depth: usize) -> Result<RonTree, String> {
        if depth > DEEPEST {
            return Err("values are nested too deep".into());
        }
        self.skip_space()?;
        let from = self.at;
        let (mut name, mut body) = (None, RonBody::Plain);
        match self.peek() {
            Some('"') => self.skip_string()?,
            Some('\'') => self.skip_character()?,
            Some('b') if self.rest().starts_with("b\"") => {
                self.at += 1;
                self.skip_string()?;
            }
            Some('r') if self.rest()[1..].trim_start_matches('#').starts_with('"') => self.skip_raw_string()?,
            Some('[') => body = RonBody::Items(self.parse_items('[', ']', depth)?),
            Some('{') => _ = self.parse_map(depth)?,
            Some('(') => body = self.parse_parentheses(depth)?,
            Some(c) if c.is_alphabetic() || c == '_' => {
                name = Some(self.read_word("").to_owned());
                let end = self.at;
                self.skip_space()?;
                if self.peek() == Some('(') { body = self.parse_parentheses(depth)? } else { self.at = end }
            }
            Some(c) if c.is_ascii_digit() || "+-.".contains(c) => _ = self.read_word("+-."),
            _ => return Err(self.unexpected_fault("a value")),
        }
        let text = &self.text[from..self.at];
        let quoted = text.ends_with('"') || (text.starts_with('r') && text.ends_with('#'));
        Ok(RonTree { span: from..self.at, name, body, quoted })
    }

    /// Skips a string, `"text"`. Returns an error if it does not end.
    fn skip_string(&mut self) -> Result<(), String> {
        self.take_sign('"');
        let mut escaped = false;
        for (i, c) in self.rest().char_indices() {
            match c {
                '"' if !escaped => {
                    self.at += i + 1;
                    return Ok(());
                }
                _ => escaped = c == '\\' && !escaped,
            }
        }
        Err("a text does not end; it lacks a `\"`".into())
    }

    /// Skips a raw string, `r#"text"#`. Returns an error if it does not end.
    fn skip_raw_string(&mut self) -> Result<(), String> {
        let marks = self.rest()[1..].find('"').unwrap_or(0);
        let (start, end) = (marks + 2, format!("\"{}", "#".repeat(marks)));
        let length = self.rest()[start..].find(&end).ok_or("a raw text does not end")?;
        self.at += start + length + end.len();
        Ok(())
    }

    /// Skips a character, `'c'`. Returns an error if it does not end.
    fn skip_character(&mut self) -> Result<(), String> {
        let inside = self.rest().char_indices().skip(if self.rest().starts_with("'\\") { 3 } else { 2 });
        let end = inside.filter(|(_, c)| *c == '\'').map(|(i, _)| i).next().ok_or("a character lacks its `'`")?;
        self.at += end + 1;
        Ok(())
    }

    /// Parses `(field: value, ..)` or `(value, ..)`. Returns an error for a missing separator or closing sign, or an
    /// invalid value.
    fn parse_parentheses(&mut self, depth: usize) -> Result<RonBody, String> {
        let from = self.at;
        self.take_sign('(');
        self.skip_space()?;
        let is_named = !self.read_word("").is_empty() && {
            self.skip_space()?;
            self.take_sign(':')
        };
        self.at = from;
        if !is_named {
            return Ok(RonBody::Items(self.parse_items('(', ')', depth)?));
        }
        let mut fields = Vec::new();
        self.take_sign('(');
        loop {
            self.skip_space()?;
            if self.take_sign(')') {
                return Ok(RonBody::Fields(fields));
            }
            let name = self.read_word("").to_owned();
            self.skip_space()?;
            if name.is_empty() || !self.take_sign(':') {
                return Err(self.unexpected_fault("`field: value`"));
            }
            fields.push((name, self.parse_value(depth + 1)?));
            self.skip_comma(')')?;
        }
    }

    /// Parses values between the signs `open` and `close`. Returns an error for a missing separator or closing sign, or
    /// an invalid value.
    fn parse_items(&mut self, open: char, close: char, depth: usize) -> Result<Vec<RonTree>, String> {
        let mut items = Vec::new();
        self.take_sign(open);
        loop {
            self.skip_space()?;
            if self.take_sign(close) {
                return Ok(items);
            }
            items.push(self.parse_value(depth + 1)?);
            self.skip_comma(close)?;
        }
    }

    /// Parses `{key: value, ..}`; returns the text ranges of the keys. Returns an error for a missing separator or
    /// closing sign, or an invalid value.
    fn parse_map(&mut self, depth: usize) -> Result<Vec<Range<usize>>, String> {
        let mut keys = Vec::new();
        self.take_sign('{');
        loop {
            self.skip_space()?;
            if self.take_sign('}') {
                return Ok(keys);
            }
            keys.push(self.parse_value(depth + 1)?.span);
            self.skip_space()?;
            if !self.take_sign(':') {
                return Err(self.unexpected_fault("`:`"));
            }
            self.parse_value(depth + 1)?;
            self.skip_comma('}')?;
        }
    }

    /// Skips a comma, which may be missing only before the sign `close`. Returns an error for other text.
    fn skip_comma(&mut self, close: char) -> Result<(), String> {
        self.skip_space()?;
        if self.take_sign(',') || self.peek() == Some(close) {
            return Ok(());
        }
        Err(self.unexpected_fault(&format!("`,` or `{close}`")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> RonTree {
        RonTree::parse(text).unwrap_or_else(|e| panic!("{text}: {e}"))
    }

    #[test]
    fn ron_tree_locates_every_value() {
        let text = r##"P(a: -1.5e-3, /* b /* é */ */ b: [X(), Y(1, "),\"("), true], // c
            c: (d: r#"a"#, e: {"x": (1, 2)}, f: 'x', g: '\'', h: None),)"##;
        let tree = of(text);
        assert_eq!(tree.name.as_deref(), Some("P"));
        let read = |name: &str| tree.field(name).unwrap().text_in(text);
        assert_eq!((read("a"), read("b")), ("-1.5e-3", r#"[X(), Y(1, "),\"("), true]"#));
        let c: Vec<&str> = tree.field("c").unwrap().fields().iter().map(|(_, t)| t.text_in(text)).collect();
        assert_eq!(c, [r##"r#"a"#"##, r#"{"x": (1, 2)}"#, "'x'", r"'\''", "None"]);
        let RonBody::Items(items) = &tree.field("b").unwrap().body else { panic!() };
        assert_eq!(items[0].name.as_deref(), Some("X"));
        assert_eq!(of(" 5 ").span, 1..2);
    }

    #[test]
    fn rejects_invalid_ron_values() {
        for text in
            ["", "(", "(a: )", "(a: 1", "[1 2]", "\"a", "r#\"a\"", "'", "own/a", "{1}", "1 2", "é(", "/* /* */ 1", ")"]
        {
            assert!(RonTree::parse(text).is_err(), "{text}");
        }
        assert!(RonTree::parse(&"[".repeat(100_000)).is_err());
    }
}
