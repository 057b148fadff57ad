//! Warnings that say the same of many things, counted instead of repeated.

use std::collections::HashMap;

/// Warnings of one kind that are all kept.
const FEW: usize = 2;
/// Kinds of warnings that are listed; the others are counted.
const MOST_KINDS: usize = 32;

/// A warning's text with its numbers and quotations left out: what all warnings of its kind have in common.
fn kind(text: &str) -> String {
    let mut kind = String::with_capacity(text.len());
    let mut quote = None;
    for character in text.chars() {
        match (quote, character) {
            (Some(end), found) if found == end => quote = None,
            (Some(_), _) => {}
            (None, '"' | '`') => {
                quote = Some(character);
                kind.push('"');
            }
            (None, '0'..='9') => {
                if !kind.ends_with('#') {
                    kind.push('#');
                }
            }
            (None, other) => kind.push(other),
        }
    }
    kind
}

/// A sentence about a number of things: `one` for a single one, `many` for several, nothing for none.
pub fn counted(count: u64, one: &str, many: &str) -> Option<String> {
    (count > 0).then(|| format!("{count} {}", if count == 1 { one } else { many }))
}

/// Things at fault: how many there are, and the number of the first.
#[derive(Default)]
pub struct Odd {
    count: u64,
    first: u64,
}

impl Odd {
    pub fn add(&mut self, number: u64) {
        if self.count == 0 {
            self.first = number;
        }
        self.count += 1;
    }

    /// A sentence as [`counted`] makes it, which also names the first: `first` and its number. Nothing for none.
    pub fn warning(&self, one: &str, many: &str, first: &str) -> Option<String> {
        let text = counted(self.count, one, many)?;
        Some(format!("{text}; the first is {first} {}", self.first))
    }
}

/// Keeps the first warnings of each kind, and counts the others: "… and 312 more like this". Each warning is a subject, which may
/// be empty, and a text; the subject does not make it another kind.
pub fn condensed<S: AsRef<str>>(warnings: impl IntoIterator<Item = (S, String)>) -> Vec<String> {
    let mut places: HashMap<String, usize> = HashMap::new();
    // For each kind: the first texts, and how many there are.
    let mut kinds: Vec<(Vec<String>, usize)> = Vec::new();
    let mut beyond = 0u64;
    for (subject, text) in warnings {
        let next = kinds.len();
        let place = if next < MOST_KINDS {
            *places.entry(kind(&text)).or_insert(next)
        } else {
            places.get(&kind(&text)).copied().unwrap_or(next)
        };
        if place == next {
            if next == MOST_KINDS {
                beyond += 1;
                continue;
            }
            kinds.push((Vec::new(), 0));
        }
        let (texts, count) = &mut kinds[place];
        *count += 1;
        if texts.len() < FEW {
            texts.push(match subject.as_ref() {
                "" => text,
                subject => format!("{subject}: {text}"),
            });
        }
    }
    let mut list = Vec::new();
    for (mut texts, count) in kinds {
        if count > FEW {
            texts.truncate(1);
            texts
                .iter_mut()
                .for_each(|text| *text += &format!(" … and {} more like this", count - 1));
        }
        list.append(&mut texts);
    }
    if beyond > 0 {
        list.push(format!("{beyond} more warnings of other kinds"));
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(texts: impl IntoIterator<Item = String>) -> Vec<String> {
        condensed(texts.into_iter().map(|text| ("", text)))
    }

    #[test]
    fn the_first_of_odd_things_is_named() {
        let mut odd = Odd::default();
        let warning = |odd: &Odd| odd.warning("normal is odd", "normals are odd", "that of vertex");
        assert_eq!(warning(&odd), None);
        odd.add(7);
        let one = "1 normal is odd; the first is that of vertex 7";
        assert_eq!(warning(&odd).as_deref(), Some(one));
        odd.add(9);
        let many = "2 normals are odd; the first is that of vertex 7";
        assert_eq!(warning(&odd).as_deref(), Some(many));
    }

    #[test]
    fn warnings_of_a_kind_are_counted() {
        let mut texts: Vec<String> = (0..313)
            .map(|i| format!("texture \"wall {i}.png\" cannot be read: {i} bytes"))
            .collect();
        texts.insert(1, "points have no normals".to_owned());
        texts.push("points have no normals".to_owned());
        assert_eq!(
            of(texts),
            [
                "texture \"wall 0.png\" cannot be read: 0 bytes … and 312 more like this",
                "points have no normals",
                "points have no normals",
            ]
        );
    }

    #[test]
    fn subjects_do_not_make_other_kinds() {
        let many = (0..5).map(|i| (format!("asset{i}"), format!("{} points skipped", i + 2)));
        assert_eq!(condensed(many), ["asset0: 2 points skipped … and 4 more like this"]);
    }

    #[test]
    fn the_list_is_bounded() {
        let letters = |i: usize| "abcdefghij".chars().nth(i % 10).unwrap();
        let texts =
            (0..1000).map(|i| format!("{}{}{}", letters(i), letters(i / 10), letters(i / 100)));
        let list = of(texts);
        assert_eq!(list.len(), MOST_KINDS + 1);
        assert_eq!(list[MOST_KINDS], "968 more warnings of other kinds");
    }
}
