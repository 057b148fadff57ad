//! Connected components.

/// Numbers in groups (a disjoint-set forest). The smallest number of a group is its root, so that groups keep the order of the file.
pub(super) struct Groups(Vec<u32>);

impl Groups {
    pub fn new(count: usize) -> Self {
        Groups((0..count as u32).collect())
    }

    pub fn root(&mut self, mut number: u32) -> u32 {
        while self.0[number as usize] != number {
            let parent = self.0[number as usize];
            self.0[number as usize] = self.0[parent as usize];
            number = parent;
        }
        number
    }

    pub fn join(&mut self, one: u32, other: u32) {
        let (one, other) = (self.root(one), self.root(other));
        self.0[one.max(other) as usize] = one.min(other);
    }

    /// The root of each number's group.
    pub fn roots(mut self) -> Vec<u32> {
        (0..self.0.len() as u32).map(|number| self.root(number)).collect()
    }
}
