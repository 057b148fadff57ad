//! Buffers, views and accessors: bytes to numbers, every range checked.

use std::borrow::Cow;
use std::cell::Cell;

use ::gltf::json::accessor::{ComponentType, Type};
use ::gltf::json::validation::Checked;
use ::gltf::json::{Index, Root, accessor, buffer};

use super::super::input::{Folder, read_bounded};
use super::super::{AssetError, ReadOptions};
use super::container::{data_uri, percent_decoded};

/// Numbers that may be read from buffers: this, and [`READS_PER_BYTE`] of what they hold. A document
/// reads its data about once; one that reads it over and over is an attack.
const FREE_READS: u64 = 4 << 20;
const READS_PER_BYTE: u64 = 16;

pub(super) struct Buffers<'a> {
    root: &'a Root,
    buffers: Vec<Cow<'a, [u8]>>,
    file: &'a str,
    reads_left: Cell<u64>,
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
        let mut buffers = Vec::with_capacity(root.buffers.len());
        let mut left = options.max_decompressed_bytes;
        for (number, buffer) in root.buffers.iter().enumerate() {
            let fail = |reason: String| {
                AssetError::malformed(file, format!("buffers[{number}]"), reason)
            };
            let bytes = match (&buffer.uri, binary) {
                (None, Some(binary)) if number == 0 => Cow::Borrowed(binary),
                (None, _) => return Err(fail("has neither a uri nor the binary chunk".to_owned())),
                (Some(uri), _) => Cow::Owned(external(uri, folder, left).map_err(fail)?),
            };
            if (bytes.len() as u64) < buffer.byte_length.0 {
                return Err(fail(format!(
                    "byteLength is {}, but there are {} bytes",
                    buffer.byte_length.0,
                    bytes.len()
                )));
            }
            left = left.saturating_sub(bytes.len() as u64);
            buffers.push(bytes);
        }
        let total: u64 = buffers.iter().map(|bytes| bytes.len() as u64).sum();
        let reads = total.saturating_mul(READS_PER_BYTE).saturating_add(FREE_READS);
        Ok(Self { root, buffers, file, reads_left: Cell::new(reads) })
    }

    /// Counts numbers (or placements) that are about to be made out of the buffers.
    pub fn spend(&self, place: &str, reads: u64) -> Result<(), AssetError> {
        match self.reads_left.get().checked_sub(reads) {
            Some(left) => {
                self.reads_left.set(left);
                Ok(())
            }
            None => Err(AssetError::malformed(
                self.file,
                place,
                "the document multiplies its buffers' data beyond all measure",
            )),
        }
    }

    fn fail(&self, place: String, reason: impl Into<String>) -> AssetError {
        AssetError::malformed(self.file, place, reason)
    }

    /// The bytes of a buffer view.
    pub fn view(&self, index: Index<buffer::View>) -> Result<&[u8], AssetError> {
        let place = || format!("bufferViews[{}]", index.value());
        let view = self.root.get(index).ok_or_else(|| self.fail(place(), "does not exist"))?;
        let buffer = self.buffers.get(view.buffer.value()).ok_or_else(|| {
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
            None if accessor.sparse.is_some() => {
                values.resize(count * components, T::default());
            }
            None => return Err(self.fail(place(), "has neither a bufferView nor sparse values")),
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

fn external(uri: &str, folder: Option<&Folder>, limit: u64) -> Result<Vec<u8>, String> {
    if let Some(bytes) = data_uri(uri) {
        return bytes;
    }
    let name = String::from_utf8(percent_decoded(uri)).map_err(|_| "its uri is no text")?;
    let folder = folder.ok_or("the asset lies in no folder, so it can name no files")?;
    let path = folder.resolve(&name).map_err(|reason| format!("{name} {reason}"))?;
    read_bounded(&path, limit).map_err(|reason| format!("{name} {reason}"))
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
