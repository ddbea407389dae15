//! From the ways in which primitives list vertices to triangles over exactly the vertices they use.

use crate::accessor::{Accessors, Reader};
use crate::error::{Fault, Place};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::Mode;
use gltf::json::{Accessor, Index};

/// Triangles of a primitive, and the vertices they use.
pub(crate) struct Topology {
    /// Triples of positions in `vertices`.
    pub triangles: Vec<[u32; 3]>,
    /// Elements of the attribute accessors.
    pub vertices: Vec<u32>,
    /// Vertices at the end that are not enough for a triangle.
    pub left_over: usize,
}

/// Reads the triangles of a primitive of `vertex_count` vertices; none for points and lines.
pub(crate) fn read(
    accessors: &Accessors,
    mode: Mode,
    indices: Option<Index<Accessor>>,
    vertex_count: usize,
    place: &Place,
) -> Result<Option<Topology>, Fault> {
    let place_count = || place.fault("has more than 2^32 vertices; split the mesh");
    let vertex_count = u32::try_from(vertex_count).map_err(|_| place_count())?;
    let reader = match indices {
        Some(index) => Some((accessors.reader(index, &[Type::Scalar], place)?, index)),
        None => None,
    };
    if let Some((reader, index)) = &reader {
        let integer =
            matches!(reader.component(), ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
        place
            .then("accessor", index.value(), None)
            .ensure(integer, || "holds indices that are not unsigned integers".to_owned())?;
    }
    let listed = reader.as_ref().map_or(vertex_count as usize, |(reader, _)| reader.count());
    accessors.charge(listed as u64, place)?;
    let at = |slot: usize| match &reader {
        Some((reader, _)) => reader.integers::<1>(slot)[0],
        None => slot as u32,
    };
    let Some(count) = triangle_count(mode, listed) else { return Ok(None) };
    let mut triangles: Vec<[u32; 3]> = (0..count).map(|triangle| corners(mode, triangle).map(at)).collect();
    let left_over = if matches!(mode, Mode::Triangles) { listed % 3 } else { 0 };
    if let Some(&wrong) = triangles.iter().flatten().find(|&&vertex| vertex >= vertex_count) {
        let index = indices.map_or(0, |index| index.value());
        return Err(place
            .then("accessor", index, None)
            .fault(format!("refers to vertex {wrong}, but there are only {vertex_count}")));
    }
    let vertices = compact(&mut triangles, vertex_count);
    Ok(Some(Topology { triangles, vertices, left_over }))
}

/// Triangles in a list of `listed` vertices; none for points and lines.
fn triangle_count(mode: Mode, listed: usize) -> Option<usize> {
    match mode {
        Mode::Triangles => Some(listed / 3),
        Mode::TriangleStrip | Mode::TriangleFan => Some(listed.saturating_sub(2)),
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => None,
    }
}

/// Places of a triangle's corners in the list (glTF 2.0, section 3.7.2.1).
fn corners(mode: Mode, triangle: usize) -> [usize; 3] {
    match mode {
        // Every other triangle is turned, so that all face the same way.
        Mode::TriangleStrip => [triangle, triangle + 1 + triangle % 2, triangle + 2 - triangle % 2],
        Mode::TriangleFan => [triangle + 1, triangle + 2, 0],
        _ => [3 * triangle, 3 * triangle + 1, 3 * triangle + 2],
    }
}

/// Renumbers the vertices so that only used ones remain, in their order; gives the old number of each.
fn compact(triangles: &mut [[u32; 3]], vertex_count: u32) -> Vec<u32> {
    // A mesh that uses a few of many vertices is not made to pay for all of them.
    if vertex_count as usize > 4 * triangles.len() + 1024 {
        let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        for vertex in triangles.iter_mut().flatten() {
            *vertex = used.binary_search(vertex).expect("every corner was listed") as u32;
        }
        return used;
    }
    let mut renumbered = vec![u32::MAX; vertex_count as usize];
    for &vertex in triangles.iter().flatten() {
        renumbered[vertex as usize] = 0;
    }
    let used: Vec<u32> = (0..vertex_count).filter(|&vertex| renumbered[vertex as usize] == 0).collect();
    for (new, &old) in used.iter().enumerate() {
        renumbered[old as usize] = new as u32;
    }
    for vertex in triangles.iter_mut().flatten() {
        *vertex = renumbered[*vertex as usize];
    }
    used
}

/// The elements of `vertices`, as `N` floats each.
pub(crate) fn gather<const N: usize>(reader: &Reader, vertices: &[u32]) -> impl Iterator<Item = [f32; N]> {
    vertices.iter().map(|&vertex| reader.floats(vertex as usize))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(mode: Mode, listed: usize) -> Vec<[usize; 3]> {
        (0..triangle_count(mode, listed).expect("triangles"))
            .map(|triangle| corners(mode, triangle))
            .collect()
    }

    #[test]
    fn strips_and_fans_keep_their_winding() {
        assert_eq!(all(Mode::Triangles, 8), [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(all(Mode::TriangleStrip, 5), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(all(Mode::TriangleFan, 5), [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
        for listed in 0..3 {
            assert!(all(Mode::TriangleStrip, listed).is_empty());
        }
        assert_eq!(triangle_count(Mode::Lines, 8), None);
    }

    #[test]
    fn only_used_vertices_remain_in_their_order() {
        for vertex_count in [10, 1 << 30] {
            let mut triangles = [[7, 2, 9], [9, 2, 7]];
            assert_eq!(compact(&mut triangles, vertex_count), [2, 7, 9]);
            assert_eq!(triangles, [[1, 0, 2], [2, 0, 1]]);
        }
    }
}
