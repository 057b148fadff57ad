//! The nearest places around a point, and lists of near points that are put together from parts of a cloud.

use super::MAX_NEIGHBORS;

/// Most places that are looked for around a point.
pub(in crate::bake) const AROUND: usize = 48;

/// A point near another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::bake) struct Near {
    /// Squared.
    pub distance: f32,
    pub index: u32,
    pub at: [f32; 3],
}

impl Near {
    pub(in crate::bake) fn new(at: [f32; 3], [x, y, z]: [f32; 3], index: u32) -> Near {
        let (dx, dy, dz) = (at[0] - x, at[1] - y, at[2] - z);
        Near { distance: dx * dx + dy * dy + dz * dz, index, at }
    }

    fn is_before(&self, other: &Near) -> bool {
        (self.distance, self.index) < (other.distance, other.index)
    }
}

/// The nearest places so far, nearest first: of the points at one place the one with the smallest index. Places at equal distances are
/// ordered by it.
#[derive(Clone, Copy, Debug)]
pub(in crate::bake) struct Places {
    found: [Near; AROUND],
    count: usize,
}

impl Default for Places {
    fn default() -> Self {
        Places { found: [Near::default(); AROUND], count: 0 }
    }
}

impl Places {
    pub(in crate::bake) fn iter(&self) -> std::slice::Iter<'_, Near> {
        self.found[..self.count].iter()
    }

    /// Squared distance beyond which no place is added; infinite while there is room.
    pub(in crate::bake) fn bound(&self) -> f32 {
        if self.count < AROUND { f32::INFINITY } else { self.found[AROUND - 1].distance }
    }

    /// Adds a point, unless it is where the distances are from; returns whether it is now among the nearest.
    pub(in crate::bake) fn add(&mut self, near: Near) -> bool {
        if !(near.distance > 0.0 && near.distance <= self.bound()) {
            return false;
        }
        let from = self.found[..self.count].partition_point(|other| other.distance < near.distance);
        let same = self.found[from..self.count].iter();
        let mut same = same.take_while(|other| other.distance == near.distance);
        if let Some(same) = same.position(|other| other.at == near.at) {
            let same = from + same;
            if self.found[same].index <= near.index {
                return false;
            }
            self.found[same..self.count].rotate_left(1);
            self.count -= 1;
        }
        insert(&mut self.found, &mut self.count, near)
    }
}

/// Inserts a point into an ascending list, whose last element makes room; returns whether it did.
fn insert(list: &mut [Near], count: &mut usize, near: Near) -> bool {
    let at = list[..*count].partition_point(|other| other.is_before(&near));
    if at >= list.len() {
        return false;
    }
    *count = (*count + 1).min(list.len());
    list[at..*count].rotate_right(1);
    list[at] = near;
    true
}

/// The points that the estimates of one point depend on: the nearest ones, and those at the nearest places.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::bake) struct Nearby {
    nearest: [Near; MAX_NEIGHBORS],
    count: usize,
    places: Places,
}

impl Nearby {
    /// Squared distance beyond which no point is added.
    pub(in crate::bake) fn bound(&self) -> f32 {
        // If all the nearest are at the point's own place, its surroundings do not matter.
        let is_one_place =
            self.count == MAX_NEIGHBORS && self.nearest[MAX_NEIGHBORS - 1].distance == 0.0;
        if is_one_place { 0.0 } else { self.places.bound() }
    }

    /// Adds a point; returns whether it is needed.
    pub(in crate::bake) fn add(&mut self, near: Near) -> bool {
        let is_near = insert(&mut self.nearest, &mut self.count, near);
        let is_place = self.places.add(near);
        is_near || is_place
    }

    /// All these points and the point itself, by index.
    pub(in crate::bake) fn with_own(&self, index: u32, at: [f32; 3]) -> Vec<(u32, [f32; 3])> {
        let near = self.nearest[..self.count].iter().chain(self.places.iter());
        let mut all: Vec<(u32, [f32; 3])> = near.map(|near| (near.index, near.at)).collect();
        all.push((index, at));
        all.sort_unstable_by_key(|&(index, _)| index);
        all.dedup_by_key(|&mut (index, _)| index);
        all
    }
}
