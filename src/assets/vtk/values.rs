//! Types of numbers, and arrays of them.

/// The type of an array's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Bit,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Kind {
    /// The type with a name of the legacy format. Identifiers are stored as 32-bit numbers there.
    pub fn of_legacy(name: &str) -> Option<Kind> {
        Some(match name.to_ascii_lowercase().as_str() {
            "bit" => Kind::Bit,
            "char" | "signed_char" | "vtktypeint8" => Kind::I8,
            "unsigned_char" | "vtktypeuint8" => Kind::U8,
            "short" | "vtktypeint16" => Kind::I16,
            "unsigned_short" | "vtktypeuint16" => Kind::U16,
            "int" | "vtkidtype" | "vtktypeint32" => Kind::I32,
            "unsigned_int" | "vtktypeuint32" => Kind::U32,
            "long" | "long_long" | "vtktypeint64" => Kind::I64,
            "unsigned_long" | "unsigned_long_long" | "vtktypeuint64" => Kind::U64,
            "float" | "vtktypefloat32" => Kind::F32,
            "double" | "vtktypefloat64" => Kind::F64,
            _ => return None,
        })
    }

    /// The type with a name of the XML format.
    pub fn of_xml(name: &str) -> Option<Kind> {
        Some(match name {
            "Int8" => Kind::I8,
            "UInt8" => Kind::U8,
            "Int16" => Kind::I16,
            "UInt16" => Kind::U16,
            "Int32" => Kind::I32,
            "UInt32" => Kind::U32,
            "Int64" => Kind::I64,
            "UInt64" => Kind::U64,
            "Float32" => Kind::F32,
            "Float64" => Kind::F64,
            _ => return None,
        })
    }

    /// Bytes of a number; eight bits share one.
    pub fn bytes(self) -> usize {
        match self {
            Kind::Bit | Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::I64 | Kind::U64 | Kind::F64 => 8,
        }
    }

    /// The number in these bytes, which are as many as the type has.
    pub fn decode(self, bytes: &[u8], is_big: bool) -> f64 {
        let mut eight = [0; 8];
        let count = self.bytes().min(bytes.len());
        // Little-endian: the lowest byte first.
        for (at, slot) in eight.iter_mut().take(count).enumerate() {
            *slot = bytes[if is_big { count - 1 - at } else { at }];
        }
        let whole = u64::from_le_bytes(eight);
        match self {
            Kind::Bit | Kind::U8 | Kind::U16 | Kind::U32 => whole as f64,
            Kind::I8 => f64::from(whole as i8),
            Kind::I16 => f64::from(whole as i16),
            Kind::I32 => f64::from(whole as i32),
            Kind::I64 => whole as i64 as f64,
            Kind::U64 => whole as f64,
            Kind::F32 => f64::from(f32::from_bits(whole as u32)),
            Kind::F64 => f64::from_bits(whole),
        }
    }
}

/// An array of numbers, some for each point or cell.
#[derive(Debug)]
pub(super) struct Array {
    pub name: String,
    /// Numbers for an element, at least one.
    pub components: usize,
    pub values: Vec<f32>,
    pub is_byte: bool,
    /// The file says that it is a colour.
    pub is_color: bool,
    pub is_normals: bool,
}

/// Names of arrays of floats that are colours.
const COLORS: [&str; 8] =
    ["color", "colors", "colour", "colours", "rgb", "rgba", "colorscalars", "color_scalars"];

impl Array {
    pub fn new(name: &str, components: usize, kind: Kind) -> Array {
        Array {
            name: name.to_owned(),
            components,
            values: Vec::new(),
            is_byte: kind == Kind::U8,
            is_color: false,
            is_normals: name.eq_ignore_ascii_case("normals"),
        }
    }

    pub fn is_color(&self) -> bool {
        let name = self.name.to_ascii_lowercase();
        let is_named = self.is_color || self.is_byte || COLORS.contains(&name.as_str());
        matches!(self.components, 3 | 4) && is_named
    }

    /// The numbers of an element.
    pub fn of(&self, element: usize) -> &[f32] {
        let begin = element.saturating_mul(self.components);
        self.values.get(begin..begin.saturating_add(self.components)).unwrap_or_default()
    }

    /// The colour of an element, in the range of the file.
    pub fn color(&self, element: usize) -> [f32; 4] {
        let opaque = if self.is_byte { 255.0 } else { f32::NAN };
        match *self.of(element) {
            [r, g, b] => [r, g, b, opaque],
            [r, g, b, a] => [r, g, b, a],
            _ => [0.0, 0.0, 0.0, opaque],
        }
    }

    /// A name for each number of an element.
    pub fn names(&self) -> Vec<String> {
        match self.components {
            1 => vec![self.name.clone()],
            count => (0..count).map(|at| format!("{}_{at}", self.name)).collect(),
        }
    }
}
