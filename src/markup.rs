//! Text in XML, SVG and HTML (floor 0).

/// Escapes the special characters of XML and HTML, and leaves out control characters, which XML does not admit.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '&' => out += "&amp;",
            '"' => out += "&quot;",
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => {}
            c => out.push(c),
        }
    }
    out
}

/// Cuts the text to so many characters, the last of which is then an ellipsis.
pub fn shortened(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn special_characters_are_escaped_and_control_characters_left_out() {
        assert_eq!(escaped("a<b>&\"c\"\u{1}\n\u{ffff}é"), "a&lt;b&gt;&amp;&quot;c&quot;é");
    }

    #[test]
    fn long_texts_end_in_an_ellipsis() {
        assert_eq!(["abc", "abcd", "äöüß"].map(|text| shortened(text, 3)), ["abc", "ab…", "äö…"]);
    }
}
