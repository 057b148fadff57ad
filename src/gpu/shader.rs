//! Composes WGSL modules from plain files.
//!
//! A line `//!include NAME` is replaced by the fragment of that name, at most once. A name in capitals is an alias that the
//! caller resolves (which visibility buffer, whether alpha is tested). [`Composed::line`] maps a line of the composition back to
//! its fragment.

use std::collections::BTreeSet;

/// Maps a fragment's name without extension to its text.
pub type Sources = fn(&str) -> Option<&'static str>;

/// A composed module.
#[derive(Clone, Debug)]
pub struct Composed {
    pub source: String,
    /// The fragment's name and the line in it, from 1, for every line of `source`.
    lines: Vec<(String, usize)>,
}

#[derive(Debug, Clone, thiserror::Error)]
pub enum ShaderError {
    #[error("shader `{from}`, line {line}: there is no fragment `{name}`")]
    Missing { from: String, line: usize, name: String },
    #[error("shader `{name}`: {message}")]
    Invalid { name: String, message: String },
}

impl Composed {
    /// The fragment and the line in it for a line of the composition, both from 1.
    pub fn line(&self, line: usize) -> Option<(&str, usize)> {
        self.lines.get(line.checked_sub(1)?).map(|(name, line)| (name.as_str(), *line))
    }
}

/// Composes the fragment `root`; `aliases` maps capital names to fragments.
///
/// # Errors
/// A fragment does not exist.
pub fn compose(
    sources: Sources,
    root: &str,
    aliases: &[(&str, &str)],
) -> Result<Composed, ShaderError> {
    let mut out = Composed { source: String::new(), lines: Vec::new() };
    let mut seen = BTreeSet::new();
    append(sources, root, aliases, &mut seen, &mut out, ("", 0))?;
    Ok(out)
}

fn append(
    sources: Sources,
    name: &str,
    aliases: &[(&str, &str)],
    seen: &mut BTreeSet<String>,
    out: &mut Composed,
    from: (&str, usize),
) -> Result<(), ShaderError> {
    let name = aliases.iter().find(|(alias, _)| *alias == name).map_or(name, |(_, target)| *target);
    if !seen.insert(name.to_owned()) {
        return Ok(());
    }
    let text = sources(name).ok_or_else(|| ShaderError::Missing {
        from: from.0.to_owned(),
        line: from.1,
        name: name.to_owned(),
    })?;
    for (index, line) in text.lines().enumerate() {
        if let Some(included) = line.trim().strip_prefix("//!include ") {
            append(sources, included.trim(), aliases, seen, out, (name, index + 1))?;
        } else {
            out.source.push_str(line);
            out.source.push('\n');
            out.lines.push((name.to_owned(), index + 1));
        }
    }
    Ok(())
}

/// Parses a composition. An error names the place in the fragment.
pub fn parse(name: &str, composed: &Composed) -> Result<naga::Module, ShaderError> {
    naga::front::wgsl::parse_str(&composed.source).map_err(|error| {
        let place = error
            .location(&composed.source)
            .and_then(|location| composed.line(location.line_number as usize))
            .map(|(fragment, line)| format!("{fragment}:{line}: "))
            .unwrap_or_default();
        ShaderError::Invalid {
            name: name.to_owned(),
            message: format!("{place}{}", error.emit_to_string(&composed.source)),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources(name: &str) -> Option<&'static str> {
        match name {
            "root" => Some("//!include a\n//!include CHOICE\nfn main() {}\n"),
            "a" => Some("const A: u32 = 1u;\n"),
            "b" => Some("//!include a\nconst B: u32 = A;\n"),
            _ => None,
        }
    }

    #[test]
    fn includes_once_and_maps_lines() {
        let composed = compose(sources, "root", &[("CHOICE", "b")]).unwrap();
        assert_eq!(composed.source, "const A: u32 = 1u;\nconst B: u32 = A;\nfn main() {}\n");
        assert_eq!(composed.line(2), Some(("b", 2)));
        assert_eq!(composed.line(3), Some(("root", 3)));
        assert!(composed.line(4).is_none());
    }

    #[test]
    fn a_missing_fragment_is_named() {
        let error = compose(sources, "root", &[]).unwrap_err();
        assert!(error.to_string().contains("`CHOICE`"), "{error}");
    }
}
