//! Buffers, views and accessors: bytes to numbers, every range checked.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::HashMap;
use std::path::PathBuf;

use ::gltf::json::accessor::{ComponentType, Type};
use ::gltf::json::validation::Checked;
use ::gltf::json::{Index, Root, accessor, buffer};
use percent_encoding::percent_decode_str;

use super::super::input::{Folder, Unread, read_bounded};
use super::super::{AssetError, ReadOptions};
use super::container::data_uri;
use crate::memory::Admission;

/// Work and memory that a document may cause, as multiples of what its buffers hold. An honest one
/// reads its data about once and keeps less than it read; one whose accessors and primitives
/// repeat the same bytes over and over is an attack.
const READS_PER_BYTE: u64 = 64;
const KEPT_PER_BYTE: u64 = 4;
/// Bytes of what is kept: a vertex with its attributes, a triangle or a placement.
const KEPT_BYTES: u64 = 96;
/// On top of that, so that small documents may be odd.
const FREE: u64 = 4 << 20;

pub(super) struct Buffers<'a> {
    root: &'a Root,
    /// Contents of the document's buffers; those of one file share an entry.
    contents: Vec<Cow<'a, [u8]>>,
    /// By buffer, its entry in `contents`.
    content_of: Vec<usize>,
    file: &'a str,
    reads_left: Cell<u64>,
    kept_left: Cell<u64>,
    pub(super) admission: Admission,
}

/// Items in a buffer, a stride apart.
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> Buffers<'a> {
    /// Loads every buffer: the GLB's own, data URIs, and files below the root.
    pub fn load(
        root: &'a Root,
        binary: Option<&'a [u8]>,
        folder: Option<&Folder>,
        file: &'a str,
        options: &ReadOptions,
    ) -> Result<Self, AssetError> {
        let mut contents: Vec<Cow<[u8]>> = Vec::new();
        let mut content_of = Vec::with_capacity(root.buffers.len());
        let mut content_of_uri: HashMap<&str, usize> = HashMap::new();
        let mut left = options.max_decompressed_bytes;
        for (number, buffer) in root.buffers.iter().enumerate() {
            let fail =
                |reason: String| AssetError::malformed(file, format!("buffers[{number}]"), reason);
            let uri = buffer.uri.as_deref();
            let known = uri.and_then(|uri| content_of_uri.get(uri).copied());
            let content = match (known, uri, binary) {
                (Some(known), _, _) => known,
                (None, Some(uri), _) => {
                    options.admission.grow(file, uri.len() as u64)?;
                    let bytes = match data_uri(uri) {
                        Some(bytes) => bytes.map_err(fail)?,
                        None => {
                            let (name, path) = external(uri, folder).map_err(fail)?;
                            read_bounded(&path, left, &options.admission).map_err(|error| {
                                match error {
                                    Unread::Interrupted(interrupt) => interrupt.into(),
                                    Unread::TooLarge { found, limit } => AssetError::TooLarge {
                                        file: name,
                                        what: "bytes beside what other buffers hold",
                                        found,
                                        limit,
                                    },
                                    Unread::Io(error) => fail(format!("{name}: {error}")),
                                }
                            })?
                        }
                    };
                    left = left.saturating_sub(bytes.len() as u64);
                    content_of_uri.insert(uri, contents.len());
                    contents.push(Cow::Owned(bytes));
                    contents.len() - 1
                }
                (None, None, Some(binary)) if number == 0 => {
                    contents.push(Cow::Borrowed(binary));
                    0
                }
                _ => return Err(fail("has neither a uri nor the binary chunk".to_owned())),
            };
            let (declared, found) = (buffer.byte_length.0, contents[content].len());
            if (found as u64) < declared {
                let reason = format!("byteLength is {declared}, but there are {found} bytes");
                return Err(fail(reason));
            }
            content_of.push(content);
        }
        let total: u64 = contents.iter().map(|bytes| bytes.len() as u64).sum();
        let allowed = |per_byte| Cell::new(total.saturating_mul(per_byte).saturating_add(FREE));
        Ok(Self {
            admission: options.admission.clone(),
            root,
            contents,
            content_of,
            file,
            reads_left: allowed(READS_PER_BYTE),
            kept_left: allowed(KEPT_PER_BYTE),
        })
    }

    /// Counts numbers that are about to be read.
    pub fn spend(&self, place: &str, reads: u64) -> Result<(), AssetError> {
        self.count_down(&self.reads_left, place, reads)
    }

    /// Counts vertices, triangles or placements that are about to be kept.
    pub fn keep(&self, place: &str, items: u64) -> Result<(), AssetError> {
        self.admission.grow(self.file, items.saturating_mul(KEPT_BYTES))?;
        self.count_down(&self.kept_left, place, items)
    }

    fn count_down(&self, left: &Cell<u64>, place: &str, by: u64) -> Result<(), AssetError> {
        let reason = "the document multiplies its buffers' data beyond all measure";
        let rest = left.get().checked_sub(by);
        left.set(rest.ok_or_else(|| AssetError::malformed(self.file, place, reason))?);
        Ok(())
    }

    fn fail(&self, place: String, reason: impl Into<String>) -> AssetError {
        AssetError::malformed(self.file, place, reason)
    }

    /// The bytes of a buffer view.
    pub fn view(&self, index: Index<buffer::View>) -> Result<&[u8], AssetError> {
        let place = || format!("bufferViews[{}]", index.value());
        let view = self.root.get(index).ok_or_else(|| self.fail(place(), "does not exist"))?;
        let content = self.content_of.get(view.buffer.value()).copied();
        let buffer = content.and_then(|content| self.contents.get(content)).ok_or_else(|| {
            self.fail(place(), format!("buffers[{}] does not exist", view.buffer.value()))
        })?;
        let offset = view.byte_offset.map_or(0, |offset| offset.0);
        slice(buffer, offset, view.byte_length.0).ok_or_else(|| {
            let range = format!("{} bytes at {offset}", view.byte_length.0);
            self.fail(place(), format!("{range} lie outside its buffer of {}", buffer.len()))
        })
    }

    pub fn accessor(
        &self,
        index: Index<accessor::Accessor>,
    ) -> Result<&'a accessor::Accessor, AssetError> {
        let place = format!("accessors[{}]", index.value());
        self.root.get(index).ok_or_else(|| self.fail(place, "does not exist"))
    }

    /// Number of items in an accessor.
    pub fn count(&self, index: Index<accessor::Accessor>) -> Result<u64, AssetError> {
        Ok(self.accessor(index)?.count.0)
    }

    /// All numbers of an accessor, normalised integers as fractions, and how many an item has.
    /// The type must be one of `types`.
    pub fn floats(
        &self,
        index: Index<accessor::Accessor>,
        types: &[Type],
    ) -> Result<(Vec<f32>, usize), AssetError> {
        let place = || format!("accessors[{}]", index.value());
        let accessor = self.accessor(index)?;
        let components = match accessor.type_ {
            Checked::Valid(kind) if types.contains(&kind) => kind.multiplicity(),
            _ => return Err(self.fail(place(), format!("type must be one of {types:?}"))),
        };
        let Checked::Valid(accessor::GenericComponentType(kind)) = accessor.component_type else {
            return Err(self.fail(place(), "componentType is unknown"));
        };
        let normalized = accessor.normalized;
        let values = self.numbers(index, accessor, kind, components, |bytes| {
            let value = decode(kind, bytes);
            if normalized { normalize(kind, value) as f32 } else { value as f32 }
        })?;
        Ok((values, components))
    }

    /// All numbers of a scalar accessor of unsigned integers.
    pub fn indices(&self, index: Index<accessor::Accessor>) -> Result<Vec<u32>, AssetError> {
        let place = || format!("accessors[{}]", index.value());
        let accessor = self.accessor(index)?;
        let scalar = matches!(accessor.type_, Checked::Valid(Type::Scalar));
        match accessor.component_type {
            Checked::Valid(accessor::GenericComponentType(
                kind @ (ComponentType::U8 | ComponentType::U16 | ComponentType::U32),
            )) if scalar => {
                self.numbers(index, accessor, kind, 1, |bytes| decode(kind, bytes) as u32)
            }
            _ => Err(self.fail(place(), "indices must be unsigned scalars")),
        }
    }

    fn numbers<T: Copy + Default>(
        &self,
        index: Index<accessor::Accessor>,
        accessor: &accessor::Accessor,
        kind: ComponentType,
        components: usize,
        convert: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>, AssetError> {
        let place = || format!("accessors[{}]", index.value());
        let count = accessor.count.0;
        self.spend(&place(), count.saturating_mul(components as u64))?;
        let count = usize::try_from(count).map_err(|_| self.fail(place(), "count is too large"))?;
        let item = components * kind.size();
        let mut values = Vec::new();
        match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
                let items = self.strided(view, offset, count, item, &place())?;
                values.reserve_exact(count * components);
                for at in 0..count {
                    let bytes = &items.bytes[at * items.stride..][..item];
                    values.extend(bytes.chunks_exact(kind.size()).map(&convert));
                }
            }
            None => {
                // An accessor without a view holds zeros. No bytes of the file stand behind them.
                self.keep(&place(), (count as u64).saturating_mul(components as u64))?;
                values.resize(count * components, T::default());
            }
        }
        if let Some(sparse) = &accessor.sparse {
            self.overlay(sparse, kind, components, &convert, &mut values, &place())?;
        }
        Ok(values)
    }

    /// Replaces single items, as sparse accessors do.
    fn overlay<T: Copy>(
        &self,
        sparse: &accessor::sparse::Sparse,
        kind: ComponentType,
        components: usize,
        convert: &impl Fn(&[u8]) -> T,
        values: &mut [T],
        place: &str,
    ) -> Result<(), AssetError> {
        let place = format!("{place}.sparse");
        self.spend(&place, sparse.count.0)?;
        let count = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
        let Checked::Valid(accessor::IndexComponentType(index_kind)) =
            sparse.indices.component_type
        else {
            return Err(self.fail(place, "componentType of its indices is unknown"));
        };
        let item = components * kind.size();
        let at = self.strided(
            sparse.indices.buffer_view,
            sparse.indices.byte_offset.0,
            count,
            index_kind.size(),
            &place,
        )?;
        let new = self.strided(
            sparse.values.buffer_view,
            sparse.values.byte_offset.0,
            count,
            item,
            &place,
        )?;
        for number in 0..count {
            let target = decode(index_kind, &at.bytes[number * at.stride..]) as usize;
            let slots = target
                .checked_mul(components)
                .and_then(|from| values.get_mut(from..)?.get_mut(..components));
            let Some(slots) = slots else {
                return Err(self.fail(place, format!("item {target} does not exist")));
            };
            let bytes = &new.bytes[number * new.stride..][..item];
            for (slot, bytes) in slots.iter_mut().zip(bytes.chunks_exact(kind.size())) {
                *slot = convert(bytes);
            }
        }
        Ok(())
    }

    /// `count` items of `item` bytes in a view; all of them are inside.
    fn strided(
        &self,
        view: Index<buffer::View>,
        offset: u64,
        count: usize,
        item: usize,
        place: &str,
    ) -> Result<Strided<'_>, AssetError> {
        let bytes = self.view(view)?;
        let stride = self.root.get(view).and_then(|view| view.byte_stride).map_or(0, |s| s.0);
        let stride = if stride == 0 { item } else { stride };
        if stride < item {
            let reason = format!("byteStride {stride} is less than an item's {item} bytes");
            return Err(self.fail(place.to_owned(), reason));
        }
        let needed = match count {
            0 => Some(0),
            _ => (count - 1).checked_mul(stride).and_then(|start| start.checked_add(item)),
        };
        let rest = needed.and_then(|needed| slice(bytes, offset, needed as u64));
        let bytes = rest.ok_or_else(|| {
            self.fail(
                place.to_owned(),
                format!("{count} items at {offset} lie outside its view of {} bytes", bytes.len()),
            )
        })?;
        Ok(Strided { bytes, stride })
    }
}

/// Name and path of the file that a uri means.
pub(super) fn external(uri: &str, folder: Option<&Folder>) -> Result<(String, PathBuf), String> {
    let name =
        percent_decode_str(uri).decode_utf8().map_err(|_| "its uri is no text")?.into_owned();
    let folder = folder.ok_or("the asset lies in no folder, so it can name no files")?;
    let path = folder.resolve(&name).map_err(|reason| format!("{name} {reason}"))?;
    Ok((name, path))
}

fn slice(bytes: &[u8], offset: u64, length: u64) -> Option<&[u8]> {
    let from = usize::try_from(offset).ok()?;
    bytes.get(from..)?.get(..usize::try_from(length).ok()?)
}

/// The number at the start of `bytes`, which are enough for `kind`.
fn decode(kind: ComponentType, bytes: &[u8]) -> f64 {
    let pair = || [bytes[0], bytes[1]];
    let quad = || [bytes[0], bytes[1], bytes[2], bytes[3]];
    match kind {
        ComponentType::I8 => f64::from(bytes[0] as i8),
        ComponentType::U8 => f64::from(bytes[0]),
        ComponentType::I16 => f64::from(i16::from_le_bytes(pair())),
        ComponentType::U16 => f64::from(u16::from_le_bytes(pair())),
        ComponentType::U32 => f64::from(u32::from_le_bytes(quad())),
        ComponentType::F32 => f64::from(f32::from_le_bytes(quad())),
    }
}

fn normalize(kind: ComponentType, value: f64) -> f64 {
    match kind {
        ComponentType::I8 => (value / 127.0).max(-1.0),
        ComponentType::U8 => value / 255.0,
        ComponentType::I16 => (value / 32767.0).max(-1.0),
        ComponentType::U16 => value / 65535.0,
        ComponentType::U32 | ComponentType::F32 => value,
    }
}
