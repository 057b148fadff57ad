//! The kinds of geometry, and what each must provide.
//!
//! The macro `kinds!` is given the list of kinds, and the file of a kind implements [`PackedKind`]. Digests, cache entries, bounds,
//! counts, and pages of GPU memory follow from these two.

use std::borrow::Cow;
use std::io::{self, Read};
use std::iter::Sum;
use std::ops::{AddAssign, Deref, Range};

use glam::{DVec3, IVec3};

use super::{Grid, PackedChunk, PackedLines, PackedMesh, PackedSamples};
use crate::math::Bounds;

/// Declares the kinds of geometry: for each its variant, its packed type, its number in cache entries and shaders, and the name of
/// its elements.
macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident($packed:ty) = $number:literal, $elements:ident;)+) => {
        /// A kind of geometry.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u32)]
        pub enum GeometryKind {
            $($(#[$doc])* $kind = $number),+
        }

        impl GeometryKind {
            /// All kinds, in the order in which they are drawn.
            pub const ALL: &[GeometryKind] = &[$(GeometryKind::$kind),+];

            /// The name of its elements.
            pub fn name(self) -> &'static str {
                match self {
                    $(GeometryKind::$kind => stringify!($elements)),+
                }
            }

            /// Number of words of an element of each array, in the order of [`PackedKind::arrays`].
            pub fn widths(self) -> &'static [usize] {
                match self {
                    $(GeometryKind::$kind => <$packed>::widths()),+
                }
            }

            /// Reads the arrays of a geometry that has these chunks.
            ///
            /// # Errors
            /// The source ends early or cannot be read.
            pub fn read(
                self,
                grid: Grid,
                chunks: Vec<PackedChunk>,
                mut arrays: Arrays<'_>,
            ) -> io::Result<PackedGeometry> {
                Ok(match self {
                    $(GeometryKind::$kind => {
                        PackedGeometry::$kind(<$packed>::read(grid, chunks, &mut arrays)?)
                    })+
                })
            }
        }

        impl PageKind {
            /// The buffers of a page.
            pub fn streams(self) -> Vec<Stream> {
                match self.kind {
                    $(GeometryKind::$kind => <$packed>::streams(self)),+
                }
            }
        }

        /// A packed geometry of any kind.
        #[derive(Clone, Debug)]
        pub enum PackedGeometry {
            $($(#[$doc])* $kind($packed)),+
        }

        impl PackedGeometry {
            pub fn kind(&self) -> GeometryKind {
                match self {
                    $(PackedGeometry::$kind(_) => GeometryKind::$kind),+
                }
            }
        }

        impl Deref for PackedGeometry {
            type Target = dyn PackedKind;

            fn deref(&self) -> &Self::Target {
                match self {
                    $(PackedGeometry::$kind(packed) => packed),+
                }
            }
        }

        /// Numbers of elements, chunks and instances.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct Counts {
            $(pub $elements: u64,)+
            pub chunks: u64,
            pub instances: u64,
        }

        impl Counts {
            /// The number of elements of a kind.
            pub fn of(&self, kind: GeometryKind) -> u64 {
                match kind {
                    $(GeometryKind::$kind => self.$elements),+
                }
            }

            /// The number of elements of all kinds together.
            pub fn elements(&self) -> u64 {
                GeometryKind::ALL.iter().map(|&kind| self.of(kind)).sum()
            }
        }

        impl AddAssign for Counts {
            fn add_assign(&mut self, other: Counts) {
                $(self.$elements += other.$elements;)+
                self.chunks += other.chunks;
                self.instances += other.instances;
            }
        }

        impl PackedGeometry {
            /// Numbers of its elements and chunks.
            pub fn counts(&self) -> Counts {
                let mut counts =
                    Counts { chunks: self.chunks().len() as u64, ..Counts::default() };
                match self {
                    $(PackedGeometry::$kind(packed) => counts.$elements = packed.len() as u64),+
                }
                counts
            }
        }
    };
}

kinds! {
    /// Samples of surfaces, drawn as points or splats, and the nodes of point trees.
    Samples(PackedSamples) = 0, samples;
    /// Triangles of meshes.
    Triangles(PackedMesh) = 1, triangles;
    /// Segments of lines.
    Lines(PackedLines) = 2, segments;
}

impl Sum for Counts {
    fn sum<I: Iterator<Item = Counts>>(counts: I) -> Counts {
        counts.fold(Counts::default(), |mut sum, counts| {
            sum += counts;
            sum
        })
    }
}

impl GeometryKind {
    /// The kind with this number.
    pub fn from_number(number: u32) -> Option<GeometryKind> {
        GeometryKind::ALL.iter().copied().find(|&kind| kind as u32 == number)
    }
}

impl PackedGeometry {
    /// The samples, if this is the kind.
    pub fn samples(&self) -> Option<&PackedSamples> {
        match self {
            PackedGeometry::Samples(samples) => Some(samples),
            _ => None,
        }
    }

    /// Bytes of GPU pages.
    pub fn gpu_bytes(&self) -> u64 {
        self.arrays().iter().map(|words| 4 * words.len() as u64).sum()
    }
}

/// Contents of a page of GPU memory, which decide the passes that draw its segments. Segments are ordered by the kinds of their pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PageKind {
    pub kind: GeometryKind,
    /// Samples are nodes of point trees.
    pub nodes: bool,
    /// Samples have clip lines.
    pub clipped: bool,
    /// Words of the scalar fields of a sample, or of a vertex of lines.
    pub value_words: u8,
    /// Lines are ribbons.
    pub ribbons: bool,
    /// Surfaces behind all of its triangles, or behind some of its samples or segments, show through.
    pub translucent: bool,
}

impl PageKind {
    /// Pages of elements without additional words.
    pub const fn plain(kind: GeometryKind) -> PageKind {
        PageKind {
            kind,
            nodes: false,
            clipped: false,
            value_words: 0,
            ribbons: false,
            translucent: false,
        }
    }
}

/// A buffer of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// The name that shaders bind.
    pub name: &'static str,
    /// Words of an element.
    pub words: usize,
    pub of: StreamOf,
}

/// The records that a stream has one element for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamOf {
    /// Samples, triangles, segments: what chunks count with `first` and `count`.
    Elements,
    /// Vertices: what chunks count with `vertex_first` and `vertex_count`.
    Vertices,
}

/// The operations that each kind of packed geometry implements. [`PackedGeometry`] dereferences to them.
pub trait PackedKind: Send + Sync {
    fn grid(&self) -> &Grid;

    fn chunks(&self) -> &[PackedChunk];

    /// Number of elements.
    fn len(&self) -> usize;

    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All arrays, as words: digests and cache entries have them in this order. The implementation names all fields, so that the
    /// compiler reports a new one.
    fn arrays(&self) -> Vec<&[u32]>;

    /// Number of words of an element of each array.
    fn widths() -> &'static [usize]
    where
        Self: Sized;

    /// Reads the arrays.
    ///
    /// # Errors
    /// The source ends early or cannot be read.
    fn read(grid: Grid, chunks: Vec<PackedChunk>, arrays: &mut Arrays<'_>) -> io::Result<Self>
    where
        Self: Sized;

    /// Checks the invariants of the arrays that passes and shaders rely on. Grid and chunks are already checked.
    ///
    /// # Errors
    /// Returns the first violation.
    fn check(&self) -> Result<(), &'static str>;

    /// The kind of the page that a chunk belongs into.
    fn page(&self, chunk: &PackedChunk) -> PageKind;

    /// The buffers of a page.
    fn streams(page: PageKind) -> Vec<Stream>
    where
        Self: Sized;

    /// The words of a stream of a page, for a range of the geometry's elements or vertices.
    fn stream(&self, page: PageKind, name: &str, range: Range<usize>) -> Cow<'_, [u32]>;

    /// First element of the list that a chunk belongs to, if the first chunks of lists are sorted by their nodes' errors.
    fn list_first(&self, _chunk: &PackedChunk) -> Option<u32> {
        None
    }

    /// Visits the elements in a range of a chunk's, each by the grid cells of its corners.
    fn visit_elements(
        &self,
        chunk: &PackedChunk,
        range: Range<usize>,
        visit: &mut dyn FnMut(&[IVec3]),
    );

    /// Visits the grid cells of all corners in a chunk.
    fn visit_cells(&self, chunk: &PackedChunk, visit: &mut dyn FnMut(IVec3)) {
        let range = chunk.elements();
        self.visit_elements(chunk, range, &mut |cells| cells.iter().copied().for_each(&mut *visit));
    }

    /// How much shorter the longest kernel axis among a range of elements is than the chunk's, in sixteenths of an octave.
    fn shortness(&self, _range: Range<usize>) -> u32 {
        0
    }

    /// The longest axis of a kernel in a median chunk, in the geometry's units, and the number of kernels.
    fn median_kernel(&self) -> (f64, f64) {
        (0.0, 0.0)
    }

    /// The box around most elements, in grid cells, without the tails of each axis; `None` where an element's absence proves nothing.
    fn core(&self) -> Option<Bounds>;

    /// Weight of an element with these corners, among all that may be strays.
    fn weight(&self, corners: &[DVec3]) -> f64;

    /// Largest weight of strays together.
    fn stray_weight(&self) -> f64;

    /// Minimum distance of a stray from the box around the rest, in diagonals of that box.
    fn stray_gap(&self) -> f64 {
        0.5
    }

    /// How far a median element extends beyond its corners, where few elements make this matter.
    fn corner_radius(&self) -> f64 {
        0.0
    }
}

/// Share of a geometry that may be strays.
pub(super) const STRAY_SHARE: f64 = 1e-3;
/// Share that each end of each axis may lose before the box around the rest is taken.
pub(super) const TAIL_SHARE: f64 = 2.5e-4;
/// Elements that the box around the rest is computed from, at most, large triangles not counted.
pub(super) const LOOKED_AT: u64 = 1 << 16;

/// Reads arrays of little-endian words, one after the other.
pub struct Arrays<'a> {
    source: &'a mut dyn Read,
    lengths: &'a [u32],
}

impl<'a> Arrays<'a> {
    /// `lengths`: number of elements of each array.
    pub fn new(source: &'a mut dyn Read, lengths: &'a [u32]) -> Arrays<'a> {
        Arrays { source, lengths }
    }

    fn next_length(&mut self) -> usize {
        let (&length, rest) = self.lengths.split_first().unwrap_or((&0, &[]));
        self.lengths = rest;
        length as usize
    }

    /// Reads the next array, whose elements are single words.
    pub(super) fn words(&mut self) -> io::Result<Vec<u32>> {
        let mut list = vec![0; self.next_length()];
        read_words(self.source, &mut list)?;
        Ok(list)
    }

    /// Reads the next array.
    pub(super) fn rows<const N: usize>(&mut self) -> io::Result<Vec<[u32; N]>> {
        let mut list = vec![[0; N]; self.next_length()];
        read_words(self.source, list.as_flattened_mut())?;
        Ok(list)
    }
}

/// Reads little-endian words.
pub(in crate::bake) fn read_words(
    source: &mut (impl Read + ?Sized),
    words: &mut [u32],
) -> io::Result<()> {
    source.read_exact(bytemuck::cast_slice_mut(words))?;
    for word in words {
        *word = u32::from_le(*word);
    }
    Ok(())
}

/// Returns an error where a condition does not hold.
pub(in crate::bake) fn holds(condition: bool, otherwise: &'static str) -> Result<(), &'static str> {
    if condition { Ok(()) } else { Err(otherwise) }
}
