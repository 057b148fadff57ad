//! Finds the known word that a misspelt one was probably meant to be (floor 0).

/// Returns the known word nearest to `word`, if one is near enough to be meant.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let lower = word.to_lowercase();
    // A candidate of one or two letters would match every longer word that begins with it.
    let is_short = |candidate: &str| candidate.len() <= 2 && lower.len() > candidate.len() + 1;
    known
        .into_iter()
        .filter(|candidate| !is_short(candidate))
        .map(|candidate| (strsim::jaro_winkler(&lower, candidate), candidate))
        .filter(|(likeness, _)| *likeness >= 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// Returns the end of a message about an unknown word: the question whether the nearest known word was meant, or nothing.
pub fn suggestion<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    nearest(word, known).map(|near| format!("; did you mean `{near}`?")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suggestions_need_likeness() {
        let known = ["reconstruct", "camera", "format"];
        assert_eq!(nearest("reconstuct", known), Some("reconstruct"));
        assert_eq!(nearest("Camera", known), Some("camera"));
        assert_eq!(nearest("zzz", known), None);
        assert_eq!(nearest("hello", ["h", "up"]), None);
        assert_eq!(nearest("hh", ["h", "up"]), Some("h"));
        assert_eq!(suggestion("formt", known), "; did you mean `format`?");
        assert_eq!(suggestion("zzz", known), "");
    }
}
