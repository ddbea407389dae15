//! Tangents for meshes that have a normal map but bring none: MikkTSpace, as glTF asks for.

use bevy_mikktspace::{Geometry, Ops, TangentSpace, generate_tangents};
use glam::{Vec2, Vec3, Vec4};
use std::collections::HashMap;

/// What tangents depend on. Without `normals` the triangles are flat.
pub(crate) struct Surface<'a> {
    pub positions: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
    pub normals: Option<&'a [Vec3]>,
    pub uvs: &'a [Vec2],
}

/// Tangents per vertex, after vertices whose corners have different ones were doubled.
pub(crate) struct Tangents {
    /// One per vertex, those of the doubles last.
    pub tangents: Vec<Vec4>,
    /// The triangles over the doubled vertices.
    pub triangles: Vec<[u32; 3]>,
    /// The vertex that each double repeats.
    pub doubles: Vec<u32>,
}

/// Given to corners whose texture coordinates do not tell.
const ANY: Vec4 = Vec4::new(1.0, 0.0, 0.0, 1.0);

/// Finds the tangents of a surface.
pub(crate) fn generate(surface: &Surface) -> Tangents {
    let finite = |triangle: &&[u32; 3]| {
        triangle.iter().all(|&vertex| {
            let normal = surface.normals.map_or(Vec3::Z, |normals| normals[vertex as usize]);
            let (position, uv) = (surface.positions[vertex as usize], surface.uvs[vertex as usize]);
            position.is_finite() && uv.is_finite() && normal.is_finite()
        })
    };
    let faces: Vec<usize> = surface
        .triangles
        .iter()
        .enumerate()
        .filter(|(_, triangle)| finite(triangle))
        .map(|(face, _)| face)
        .collect();
    let mut corners = Corners { surface, faces, tangents: vec![[ANY; 3]; surface.triangles.len()] };
    // The error type has no values.
    let _ = generate_tangents(&mut corners);
    weld(surface, &corners.tangents)
}

/// One vertex per pair of vertex and tangent; the first tangent met stays with the vertex itself.
fn weld(surface: &Surface, corners: &[[Vec4; 3]]) -> Tangents {
    let vertices = surface.positions.len();
    let mut first: Vec<Option<Vec4>> = vec![None; vertices];
    let mut others: HashMap<(u32, [u32; 4]), u32> = HashMap::new();
    let (mut doubles, mut double_tangents) = (vec![], vec![]);
    let mut triangles = surface.triangles.to_vec();
    for (vertex, &tangent) in triangles.iter_mut().flatten().zip(corners.iter().flatten()) {
        if *first[*vertex as usize].get_or_insert(tangent) == tangent {
            continue;
        }
        *vertex = *others.entry((*vertex, tangent.to_array().map(f32::to_bits))).or_insert_with(|| {
            doubles.push(*vertex);
            double_tangents.push(tangent);
            (vertices + doubles.len() - 1) as u32
        });
    }
    let tangents = first.into_iter().map(|tangent| tangent.unwrap_or(ANY)).chain(double_tangents).collect();
    Tangents { tangents, triangles, doubles }
}

struct Corners<'a> {
    surface: &'a Surface<'a>,
    faces: Vec<usize>,
    tangents: Vec<[Vec4; 3]>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.surface.triangles[self.faces[face]][corner] as usize
    }
}

/// Functions that give the same bits on every machine.
struct Portable;

impl Ops for Portable {
    fn sqrt(x: f32) -> f32 {
        libm::sqrtf(x)
    }

    fn acos(x: f32) -> f32 {
        libm::acos(f64::from(x)) as f32
    }
}

impl Geometry<Portable> for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.faces.len()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, vert: usize) -> [f32; 3] {
        self.surface.positions[self.vertex(face, vert)].to_array()
    }

    fn normal(&self, face: usize, vert: usize) -> [f32; 3] {
        let normal = match self.surface.normals {
            Some(normals) => normals[self.vertex(face, vert)],
            None => {
                let [a, b, c] = [0, 1, 2].map(|corner| self.surface.positions[self.vertex(face, corner)]);
                (b - a).cross(c - a).normalize_or_zero()
            }
        };
        normal.to_array()
    }

    /// MikkTSpace has v upwards, glTF downwards.
    fn tex_coord(&self, face: usize, vert: usize) -> [f32; 2] {
        let uv = self.surface.uvs[self.vertex(face, vert)];
        [uv.x, -uv.y]
    }

    fn set_tangent(&mut self, tangent_space: Option<TangentSpace>, face: usize, vert: usize) {
        if let Some(space) = tangent_space {
            let tangent = Vec4::from_array(space.tangent_encoded());
            if tangent.is_finite() && tangent.truncate() != Vec3::ZERO {
                self.tangents[self.faces[face]][vert] = tangent;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [Vec3; 4] = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)];
    const TRIANGLES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    fn tangents(uvs: [Vec2; 4], normals: Option<&[Vec3]>) -> Tangents {
        generate(&Surface { positions: &SQUARE, triangles: &TRIANGLES, normals, uvs: &uvs })
    }

    #[test]
    fn an_upright_image_has_its_green_axis_upwards() {
        let upright = SQUARE.map(|p| Vec2::new(p.x, 1.0 - p.y));
        for normals in [None, Some(&[Vec3::Z; 4][..])] {
            let made = tangents(upright, normals);
            assert!(
                made.doubles.is_empty()
                    && made.tangents.iter().all(|&tangent| tangent == Vec4::new(1.0, 0.0, 0.0, 1.0))
            );
            let bitangent = Vec3::Z.cross(made.tangents[0].truncate()) * made.tangents[0].w;
            assert_eq!(bitangent, Vec3::Y, "glTF: bitangent = cross(normal, tangent) * w, up in the image");
        }
        let mirrored = SQUARE.map(|p| Vec2::new(1.0 - p.x, 1.0 - p.y));
        assert_eq!(tangents(mirrored, None).tangents[0], Vec4::new(-1.0, 0.0, 0.0, -1.0));
    }

    #[test]
    fn a_vertex_between_two_directions_is_doubled() {
        // The second triangle has its image mirrored, which no vertex can share.
        let mut uvs = SQUARE.map(|p| Vec2::new(p.x, 1.0 - p.y));
        uvs[3] = Vec2::new(2.0, 0.5);
        let made = tangents(uvs, Some(&[Vec3::Z; 4]));
        assert_eq!(made.doubles.len(), 2);
        assert_eq!(made.tangents.len(), 6);
        for (triangle, original) in made.triangles.iter().zip(TRIANGLES) {
            for (&vertex, old) in triangle.iter().zip(original) {
                let source = if vertex < 4 { vertex } else { made.doubles[vertex as usize - 4] };
                assert_eq!(source, old);
            }
            assert!(
                triangle
                    .iter()
                    .all(|&v| made.tangents[v as usize].w == made.tangents[triangle[0] as usize].w)
            );
        }
    }

    #[test]
    fn vertices_that_are_not_finite_get_some_tangent() {
        let positions = [Vec3::NAN, Vec3::X, Vec3::Y];
        let uvs = [Vec2::ZERO, Vec2::X, Vec2::Y];
        let made =
            generate(&Surface { positions: &positions, triangles: &[[0, 1, 2]], normals: None, uvs: &uvs });
        assert_eq!(made.tangents, [ANY; 3]);
    }
}
