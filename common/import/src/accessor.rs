//! Typed views of the scene's buffers (glTF 2.0, section 3.6). Every range is checked against the bytes that are there before
//! anything is allocated; afterwards elements are read one by one, wherever they are needed.

use crate::error::{Fault, Place};
use crate::source::Source;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Root, buffer};
use std::borrow::Cow;
use std::cell::Cell;

/// Elements that a document may ask for beyond what its buffers pay for: accessors without a buffer view are zero, and sparse
/// morph targets nearly so.
const FREE_ELEMENTS: u64 = 1 << 25;

/// Elements per byte of buffer: a byte can be an index of its own, and several meshes may share a vertex.
const ELEMENTS_PER_BYTE: u64 = 16;

/// The buffers of a document, and what may still be decoded from them.
pub(crate) struct Accessors<'a> {
    root: &'a Root,
    buffers: Vec<Option<Cow<'a, [u8]>>>,
    elements_left: Cell<u64>,
}

impl<'a> Accessors<'a> {
    /// Reads all buffers; `bin` is the one that came with the container.
    pub fn load(root: &'a Root, bin: Option<&'a [u8]>, source: &Source) -> Result<Self, Fault> {
        let mut buffers = Vec::with_capacity(root.buffers.len());
        for (index, buffer) in root.buffers.iter().enumerate() {
            let place = Place::new("buffer", index, buffer.name.as_deref());
            let bytes = match (&buffer.uri, bin) {
                (Some(uri), _) => Some(Cow::Owned(source.fetch(uri, buffer.byte_length.0, &place)?)),
                (None, Some(bin)) if index == 0 => Some(Cow::Borrowed(bin)),
                (None, _) => None,
            };
            if let Some(bytes) = &bytes {
                let (declared, held) = (buffer.byte_length.0, bytes.len());
                place.ensure(declared <= held as u64, || {
                    format!("declares {declared} bytes, but only {held} are there; the file may be cut short")
                })?;
            }
            buffers.push(bytes);
        }
        let bytes: u64 = buffers.iter().flatten().map(|bytes| bytes.len() as u64).sum();
        let elements_left = Cell::new(FREE_ELEMENTS + ELEMENTS_PER_BYTE * bytes);
        Ok(Self { root, buffers, elements_left })
    }

    /// Takes `elements` off what may be decoded, before they are allocated.
    pub fn charge(&self, elements: u64, place: &Place) -> Result<(), Fault> {
        let left = self.elements_left.get().checked_sub(elements);
        let left =
            left.ok_or_else(|| place.fault("asks for far more data than the file's buffers could hold"))?;
        self.elements_left.set(left);
        Ok(())
    }

    /// The bytes of a buffer view.
    pub fn view(&'a self, index: Index<buffer::View>, place: &Place) -> Result<&'a [u8], Fault> {
        let view = &self.root.buffer_views[index.value()];
        let place = place.then("bufferView", index.value(), view.name.as_deref());
        let buffer = view.buffer.value();
        let Some(bytes) = &self.buffers[buffer] else {
            return Err(
                place.fault(format!("buffer {buffer} has no URI and is not in the container; add its data"))
            );
        };
        let (offset, length) = (view.byte_offset.unwrap_or_default().0, view.byte_length.0);
        let declared = self.root.buffers[buffer].byte_length.0;
        let end = offset.checked_add(length).filter(|&end| end <= declared);
        let range = end.map(|end| offset as usize..end as usize).and_then(|range| bytes.get(range));
        range.ok_or_else(|| {
            place.fault(format!(
                "{length} bytes at {offset} reach past the {declared} bytes of buffer {buffer}"
            ))
        })
    }

    /// A reader of the accessor's elements, which must be of one of the `types`; all of them are there.
    pub fn reader(
        &'a self,
        index: Index<Accessor>,
        types: &[Type],
        place: &Place,
    ) -> Result<Reader<'a>, Fault> {
        let accessor = &self.root.accessors[index.value()];
        let place = place.then("accessor", index.value(), accessor.name.as_deref());
        let (Checked::Valid(component), Checked::Valid(kind)) = (&accessor.component_type, &accessor.type_)
        else {
            return Err(place.fault("has a component type or type that glTF 2.0 does not know"));
        };
        place.ensure(types.iter().any(|wanted| same_type(*wanted, *kind)), || {
            let wanted: Vec<_> = types.iter().map(|&wanted| type_name(wanted)).collect();
            format!("is of type {}, but {} is wanted there", type_name(*kind), wanted.join(" or "))
        })?;
        let element = Element { component: component.0, components: kind.multiplicity() };
        let count =
            usize::try_from(accessor.count.0).map_err(|_| place.fault("has more elements than memory"))?;
        let base = self.base(accessor, element, count, &place)?;
        let sparse = self.sparse(accessor, element, count, &place)?;
        Ok(Reader { element, normalized: accessor.normalized, count, base, sparse })
    }

    fn base(
        &'a self,
        accessor: &Accessor,
        element: Element,
        count: usize,
        place: &Place,
    ) -> Result<Option<Strided<'a>>, Fault> {
        let Some(view) = accessor.buffer_view else { return Ok(None) };
        let bytes = self.view(view, place)?;
        let stride = match self.root.buffer_views[view.value()].byte_stride {
            None => element.size(),
            Some(buffer::Stride(stride)) => {
                let sane = stride >= element.size() && stride <= 252;
                place.ensure(sane, || {
                    format!("byteStride {stride} of bufferView {view} must be from {} to 252", element.size())
                })?;
                stride
            }
        };
        let offset = accessor.byte_offset.unwrap_or_default().0;
        strided(bytes, offset, stride, element.size(), count, place).map(Some)
    }

    fn sparse(
        &'a self,
        accessor: &Accessor,
        element: Element,
        count: usize,
        place: &Place,
    ) -> Result<Option<Sparse<'a>>, Fault> {
        let Some(sparse) = &accessor.sparse else { return Ok(None) };
        let place = place.field("sparse");
        let Checked::Valid(component) = &sparse.indices.component_type else {
            return Err(place.fault("has indices of a component type that glTF 2.0 does not know"));
        };
        let substitutes = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
        place.ensure(substitutes <= count, || format!("replaces {substitutes} of {count} elements"))?;
        let index = Element { component: component.0, components: 1 };
        let bytes = self.view(sparse.indices.buffer_view, &place)?;
        let indices =
            strided(bytes, sparse.indices.byte_offset.0, index.size(), index.size(), substitutes, &place)?;
        let bytes = self.view(sparse.values.buffer_view, &place)?;
        let values =
            strided(bytes, sparse.values.byte_offset.0, element.size(), element.size(), substitutes, &place)?;
        let indices: Vec<u32> =
            (0..substitutes).map(|at| index.component.unsigned(indices.get(at))).collect();
        let sorted = indices.windows(2).all(|pair| pair[0] < pair[1]);
        let inside = indices.last().is_none_or(|&last| (last as usize) < count);
        place.ensure(sorted && inside, || "has indices that do not increase or are not there".to_owned())?;
        Ok(Some(Sparse { indices, values }))
    }
}

/// The type as glTF spells it.
fn type_name(kind: Type) -> &'static str {
    match kind {
        Type::Scalar => "SCALAR",
        Type::Vec2 => "VEC2",
        Type::Vec3 => "VEC3",
        Type::Vec4 => "VEC4",
        Type::Mat2 => "MAT2",
        Type::Mat3 => "MAT3",
        Type::Mat4 => "MAT4",
    }
}

fn same_type(a: Type, b: Type) -> bool {
    std::mem::discriminant(&a) == std::mem::discriminant(&b)
}

/// The layout of one element.
#[derive(Clone, Copy)]
struct Element {
    component: ComponentType,
    components: usize,
}

impl Element {
    fn size(self) -> usize {
        self.component.size() * self.components
    }
}

/// Elements at equal distances.
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

impl<'a> Strided<'a> {
    fn get(&self, index: usize) -> &'a [u8] {
        &self.bytes[index * self.stride..][..self.size]
    }
}

fn strided<'a>(
    bytes: &'a [u8],
    offset: u64,
    stride: usize,
    size: usize,
    count: usize,
    place: &Place,
) -> Result<Strided<'a>, Fault> {
    let length = match count {
        0 => Some(0),
        _ => {
            ((count - 1) as u64).checked_mul(stride as u64).and_then(|length| length.checked_add(size as u64))
        }
    };
    let end = length.and_then(|length| length.checked_add(offset)).filter(|&end| end <= bytes.len() as u64);
    let Some(end) = end else {
        let held = bytes.len();
        return Err(place.fault(format!(
            "{count} elements of {size} bytes, {stride} apart, at {offset} reach past the {held} bytes of the buffer view"
        )));
    };
    // An empty range may lie anywhere inside.
    Ok(Strided { bytes: &bytes[(offset as usize).min(end as usize)..end as usize], stride, size })
}

struct Sparse<'a> {
    indices: Vec<u32>,
    values: Strided<'a>,
}

/// Elements of one accessor.
pub(crate) struct Reader<'a> {
    element: Element,
    normalized: bool,
    count: usize,
    base: Option<Strided<'a>>,
    sparse: Option<Sparse<'a>>,
}

impl<'a> Reader<'a> {
    /// Number of elements.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Kind of the components.
    pub fn component(&self) -> ComponentType {
        self.element.component
    }

    /// Components per element.
    pub fn components(&self) -> usize {
        self.element.components
    }

    /// Whether integers stand for [0, 1] or [-1, 1] although the accessor does not say so.
    pub fn normalized(mut self) -> Self {
        self.normalized = true;
        self
    }

    /// An element's first `N` components; those it does not have are 0.
    pub fn floats<const N: usize>(&self, index: usize) -> [f32; N] {
        let mut values = [0.0; N];
        if let Some(bytes) = self.bytes(index) {
            let component = self.element.component;
            for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(component.size())) {
                *value = component.float(bytes, self.normalized);
            }
        }
        values
    }

    /// An element's first `N` components as unsigned integers; those it does not have are 0.
    pub fn integers<const N: usize>(&self, index: usize) -> [u32; N] {
        let mut values = [0; N];
        if let Some(bytes) = self.bytes(index) {
            let component = self.element.component;
            for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(component.size())) {
                *value = component.unsigned(bytes);
            }
        }
        values
    }

    fn bytes(&self, index: usize) -> Option<&'a [u8]> {
        if let Some(sparse) = &self.sparse
            && let Ok(at) =
                u32::try_from(index).map_err(|_| 0).and_then(|index| sparse.indices.binary_search(&index))
        {
            return Some(sparse.values.get(at));
        }
        self.base.as_ref().map(|base| base.get(index))
    }
}

/// Conversions of glTF 2.0, section 3.6.2.2 and KHR_mesh_quantization; `bytes` are one component, little endian.
trait Convert {
    fn float(self, bytes: &[u8], normalized: bool) -> f32;
    fn unsigned(self, bytes: &[u8]) -> u32;
}

impl Convert for ComponentType {
    fn float(self, bytes: &[u8], normalized: bool) -> f32 {
        let (value, one) = match (self, bytes) {
            (Self::I8, &[a]) => (f32::from(a as i8), 127.0),
            (Self::U8, &[a]) => (f32::from(a), 255.0),
            (Self::I16, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])), 32767.0),
            (Self::U16, &[a, b]) => (f32::from(u16::from_le_bytes([a, b])), 65535.0),
            (Self::F32, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
            (Self::U32, &[a, b, c, d]) => (u32::from_le_bytes([a, b, c, d]) as f32, 4_294_967_295.0),
            _ => unreachable!("a component has its type's size"),
        };
        if normalized { (value / one).max(-1.0) } else { value }
    }

    fn unsigned(self, bytes: &[u8]) -> u32 {
        match (self, bytes) {
            (Self::U8, &[a]) => u32::from(a),
            (Self::U16, &[a, b]) => u32::from(u16::from_le_bytes([a, b])),
            (Self::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
            // No caller lets other types through.
            _ => 0,
        }
    }
}
