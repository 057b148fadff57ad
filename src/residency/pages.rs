//! Pages: buffers of a size that a shader can bind, in which chunks of one kind of geometry lie.

use std::collections::BTreeMap;

use super::arena::Arena;
use super::{Page, Piece};
use crate::bake::pack::{GeometryKind, PackedChunk, PackedGeometry, PageKind, Stream, StreamOf};
use crate::gpu::Gpu;
use crate::gpu::buffer::Buffer;

/// A page does not take fewer chunks than this of a geometry that goes on elsewhere: each part is a segment with its own dispatch.
const FEW_CHUNKS: usize = 64;

/// The buffers of a page, as [`PageKind::streams`] lists them.
struct PageBuffers {
    elements: Arena,
    /// For kinds whose chunks have vertices.
    vertices: Option<Arena>,
    streams: Vec<Stream>,
}

/// All pages, by kind.
pub(super) struct Pages(BTreeMap<PageKind, Vec<PageBuffers>>);

impl PageBuffers {
    fn new(gpu: &Gpu, kind: PageKind) -> PageBuffers {
        let streams = kind.streams();
        let strides = |of| -> Vec<u64> {
            let own = streams.iter().filter(|stream| stream.of == of);
            own.map(|stream| 4 * stream.words as u64).collect()
        };
        let elements = Arena::new(gpu, kind.kind.name(), &strides(StreamOf::Elements));
        let strides = strides(StreamOf::Vertices);
        let vertices = (!strides.is_empty()).then(|| Arena::new(gpu, "vertices", &strides));
        PageBuffers { elements, vertices, streams }
    }

    /// The streams with their arenas, and with their numbers there.
    fn places(&self) -> impl Iterator<Item = (&Stream, &Arena, usize)> {
        let of = |of| self.streams.iter().filter(move |stream| stream.of == of);
        let elements = of(StreamOf::Elements).zip(0..);
        let elements = elements.map(|(stream, number)| (stream, &self.elements, number));
        let vertices = self.vertices.iter().flat_map(move |arena| {
            of(StreamOf::Vertices).zip(0..).map(move |(stream, number)| (stream, arena, number))
        });
        elements.chain(vertices)
    }

    /// Allocates room for elements and vertices; `None` if one of them does not fit.
    fn allocate(&mut self, gpu: &Gpu, elements: u32, vertices: u32) -> Option<(u32, u32)> {
        let start = self.elements.allocate(gpu, elements)?;
        let Some(arena) = &mut self.vertices else { return Some((start, 0)) };
        let vertex_start = arena.allocate(gpu, vertices);
        if vertex_start.is_none() {
            self.elements.release(start, elements);
        }
        Some((start, vertex_start?))
    }
}

impl Pages {
    /// Creates an empty page of each kind.
    pub fn new(gpu: &Gpu) -> Pages {
        let page = |&kind: &GeometryKind| {
            let kind = PageKind::plain(kind);
            (kind, vec![PageBuffers::new(gpu, kind)])
        };
        Pages(GeometryKind::ALL.iter().map(page).collect())
    }

    /// The buffer of a page that shaders call `name`.
    pub fn buffer(&self, page: Page, name: &str) -> Option<&Buffer> {
        let buffers = self.0.get(&page.kind)?.get(page.index)?;
        let (_, arena, number) = buffers.places().find(|(stream, ..)| stream.name == name)?;
        Some(arena.buffer(number))
    }

    /// Writes the chunks of a geometry from `from` on into a page of their kind, as many as fit there.
    pub fn place(&mut self, gpu: &Gpu, geometry: &PackedGeometry, from: usize) -> Piece {
        let origin = &geometry.chunks()[from];
        let kind = geometry.page(origin);
        // Chunks of one kind of page stand together.
        let run = geometry.chunks()[from..].iter().take_while(|chunk| geometry.page(chunk) == kind);
        let chunks = &geometry.chunks()[from..from + run.count()];
        let whole = Extent::of(chunks);
        let pages = self.0.entry(kind).or_default();
        let mut index = 0;
        loop {
            let is_fresh = index == pages.len();
            if is_fresh {
                pages.push(PageBuffers::new(gpu, kind));
            }
            let page = &mut pages[index];
            let room = Extent {
                elements: page.elements.room(whole.elements),
                vertices: page.vertices.as_ref().map_or(0, |arena| arena.room(whole.vertices)),
            };
            let count = fitting_run(chunks, &room);
            if count == chunks.len() || count >= FEW_CHUNKS || is_fresh {
                let Extent { elements, vertices } = Extent::of(&chunks[..count]);
                if let Some((start, vertex_start)) = page.allocate(gpu, elements, vertices) {
                    for (stream, arena, number) in page.places() {
                        let (start, first, length) = match stream.of {
                            StreamOf::Elements => (start, origin.first, elements),
                            StreamOf::Vertices => (vertex_start, origin.vertex_first, vertices),
                        };
                        let range = first as usize..(first + length) as usize;
                        let words = geometry.stream(kind, stream.name, range);
                        arena.write(gpu, number, start, &words);
                    }
                    return Piece {
                        page: Page { kind, index },
                        first_chunk: 0,
                        chunk_count: count as u32,
                        start,
                        length: elements,
                        vertex_start,
                        vertex_length: vertices,
                    };
                }
            }
            index += 1;
        }
    }

    pub fn release(&mut self, piece: &Piece) {
        let pages = self.0.get_mut(&piece.page.kind);
        let Some(page) = pages.and_then(|pages| pages.get_mut(piece.page.index)) else { return };
        page.elements.release(piece.start, piece.length);
        if let Some(vertices) = &mut page.vertices {
            vertices.release(piece.vertex_start, piece.vertex_length);
        }
    }

    /// Gives back memory that no geometry uses.
    pub fn trim(&mut self, gpu: &Gpu) {
        for page in self.0.values_mut().flatten() {
            page.elements.trim(gpu);
            page.vertices.iter_mut().for_each(|arena| arena.trim(gpu));
        }
    }
}

/// Numbers of elements and vertices.
struct Extent {
    elements: u32,
    vertices: u32,
}

impl Extent {
    /// The extent of consecutive chunks.
    fn of(chunks: &[PackedChunk]) -> Extent {
        let (Some(first), Some(last)) = (chunks.first(), chunks.last()) else {
            return Extent { elements: 0, vertices: 0 };
        };
        Extent {
            elements: last.first + last.count - first.first,
            vertices: last.vertex_first + last.vertex_count - first.vertex_first,
        }
    }
}

/// The number of chunks from the beginning on that fit into a room.
fn fitting_run(chunks: &[PackedChunk], room: &Extent) -> usize {
    let (mut elements, mut vertices) = (0u32, 0u32);
    let fits = |chunk: &&PackedChunk| {
        elements = elements.saturating_add(chunk.count);
        vertices = vertices.saturating_add(chunk.vertex_count);
        elements <= room.elements && vertices <= room.vertices
    };
    chunks.iter().take_while(fits).count()
}
