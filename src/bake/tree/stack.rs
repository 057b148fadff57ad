//! Merges elements that arrive in Morton order, octree cell by octree cell, as soon as a cell is complete.

/// Maximum number of children of a node.
pub const CHILDREN: usize = 8;

/// The level of the smallest cell that two codes share: 0 where they are equal.
pub fn shared_level(a: u64, b: u64) -> u32 {
    (u64::BITS - (a ^ b).leading_zeros()).div_ceil(3)
}

/// Elements that wait for more members of their cell.
pub struct Stack<T> {
    /// Incomplete cells as (level, members), larger cells first. The members' own cells are smaller.
    cells: Vec<(u32, Vec<T>)>,
    /// The last element, merged with its complete cells.
    last: Option<T>,
    /// Members of one cell of the finest level, which may exceed the number of children of a node: entry `i` holds results of `i`
    /// merges.
    rounds: Vec<Vec<T>>,
    has_rounds: bool,
    /// Empty lists for reuse.
    spare: Vec<Vec<T>>,
}

impl<T> Stack<T> {
    pub fn new() -> Stack<T> {
        Stack {
            cells: Vec::new(),
            last: None,
            rounds: Vec::new(),
            has_rounds: false,
            spare: Vec::new(),
        }
    }

    /// Prepares for the next element: merges the cells that are complete. `level` is the level of the smallest cell that the next
    /// element shares with the last; the first element shares none.
    pub fn advance(&mut self, level: u32, merge: &mut impl FnMut(&[T]) -> T) {
        let Some(last) = self.last.take() else { return };
        let last = self.complete(level, last, merge);
        match self.cells.last_mut() {
            _ if level == 0 => self.push_finest(last, merge),
            Some((own, members)) if *own == level => members.push(last),
            _ => {
                let mut members = self.spare.pop().unwrap_or_default();
                members.push(last);
                self.cells.push((level, members));
            }
        }
    }

    /// Takes the next element; call [`Stack::advance`] first.
    pub fn put(&mut self, next: T) {
        self.last = Some(next);
    }

    /// Merges everything that is left into one element; `None` if there were no elements.
    pub fn finish(mut self, merge: &mut impl FnMut(&[T]) -> T) -> Option<T> {
        let last = self.last.take()?;
        Some(self.complete(u32::MAX, last, merge))
    }

    /// Merges `last` with the members of all cells smaller than `level`, which are complete.
    fn complete(&mut self, level: u32, mut last: T, merge: &mut impl FnMut(&[T]) -> T) -> T {
        if level > 0 && self.has_rounds {
            last = self.merge_rounds(last, merge);
        }
        while self.cells.last().is_some_and(|(own, _)| *own < level) {
            let Some((_, mut members)) = self.cells.pop() else { break };
            members.push(last);
            last = merge(&members);
            members.clear();
            self.spare.push(members);
        }
        last
    }

    /// Adds a member that is not the last of its cell, at the finest level.
    fn push_finest(&mut self, mut member: T, merge: &mut impl FnMut(&[T]) -> T) {
        self.has_rounds = true;
        for round in 0.. {
            if round == self.rounds.len() {
                self.rounds.push(Vec::with_capacity(CHILDREN));
            }
            let members = &mut self.rounds[round];
            members.push(member);
            if members.len() < CHILDREN {
                return;
            }
            member = merge(members);
            members.clear();
        }
    }

    /// Merges all members of a cell of the finest level with its last member.
    fn merge_rounds(&mut self, last: T, merge: &mut impl FnMut(&[T]) -> T) -> T {
        self.has_rounds = false;
        let mut carried = last;
        for members in &mut self.rounds {
            if !members.is_empty() {
                members.push(carried);
                carried = merge(members);
                members.clear();
            }
        }
        carried
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A subtree, as the codes below it and its height.
    #[derive(Clone, Debug)]
    struct Part {
        codes: Vec<u64>,
        height: usize,
    }

    proptest! {
        #[test]
        fn every_cell_is_merged_once_it_is_complete(
            mut codes in prop::collection::vec(prop_oneof![0u64..6, 0u64..4096, any::<u64>()], 1..300),
        ) {
            codes.iter_mut().for_each(|code| *code >>= 1);
            codes.sort_unstable();
            let mut merges = 0;
            let mut merge = |members: &[Part]| {
                assert!((2..=CHILDREN).contains(&members.len()));
                let all: Vec<u64> = members.iter().flat_map(|part| part.codes.clone()).collect();
                assert!(all.is_sorted());
                let level = shared_level(all[0], all[all.len() - 1]);
                // A merge covers exactly its cell; at the finest level it may cover a part.
                let cell = |code: u64| code.checked_shr(3 * level).unwrap_or(0);
                let whole = codes.iter().filter(|&&code| cell(code) == cell(all[0])).count();
                assert!(if level == 0 { all.len() <= whole } else { all.len() == whole });
                merges += 1;
                let height = members.iter().map(|part| part.height).max().unwrap_or(0) + 1;
                Part { codes: all, height }
            };
            let mut stack = Stack::new();
            let mut last = codes[0];
            for &code in &codes {
                stack.advance(shared_level(last, code), &mut merge);
                stack.put(Part { codes: vec![code], height: 0 });
                last = code;
            }
            let root = stack.finish(&mut merge).unwrap();
            prop_assert_eq!(&root.codes, &codes);
            // One level for each of the octree's, and one for each factor of eight of equal codes.
            prop_assert!(root.height <= 21 + 3);
            prop_assert!(merges < codes.len());
        }
    }
}
