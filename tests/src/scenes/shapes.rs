//! Triangle meshes of simple shapes, counter-clockwise as seen from the front.

use glam::{DVec3, Vec3};
use std::collections::BTreeMap;

/// A triangle mesh with a normal per vertex.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// Vertices.
    pub positions: Vec<[f32; 3]>,
    /// Unit length, one per vertex.
    pub normals: Vec<[f32; 3]>,
    /// Three vertices each.
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// Both shapes.
    pub fn with(mut self, other: &Shape) -> Self {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        self.triangles.extend(other.triangles.iter().map(|triangle| triangle.map(|vertex| vertex + first)));
        self
    }
}

/// A flat quadrilateral.
pub fn quad(corners: [[f32; 3]; 4]) -> Shape {
    let [a, b, c, _] = corners.map(Vec3::from);
    let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize().as_vec3().to_array();
    Shape { positions: corners.to_vec(), normals: vec![normal; 4], triangles: vec![[0, 1, 2], [0, 2, 3]] }
}

/// A horizontal rectangle that faces up.
pub fn floor(y: f32, [x0, x1]: [f32; 2], [z0, z1]: [f32; 2]) -> Shape {
    quad([[x0, y, z0], [x0, y, z1], [x1, y, z1], [x1, y, z0]])
}

/// A horizontal rectangle that faces down.
pub fn ceiling(y: f32, [x0, x1]: [f32; 2], [z0, z1]: [f32; 2]) -> Shape {
    quad([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]])
}

/// A ceiling with a rectangular hole.
pub fn ceiling_with_hole(y: f32, [x0, x1]: [f32; 2], [z0, z1]: [f32; 2], hole: [[f32; 2]; 2]) -> Shape {
    let [[u0, u1], [w0, w1]] = hole;
    ceiling(y, [x0, x1], [z0, w0])
        .with(&ceiling(y, [x0, x1], [w1, z1]))
        .with(&ceiling(y, [x0, u0], [w0, w1]))
        .with(&ceiling(y, [u1, x1], [w0, w1]))
}

/// An axis-parallel box with outward faces.
pub fn cuboid([x0, y0, z0]: [f32; 3], [x1, y1, z1]: [f32; 3]) -> Shape {
    floor(y1, [x0, x1], [z0, z1])
        .with(&ceiling(y0, [x0, x1], [z0, z1]))
        .with(&quad([[x0, y0, z0], [x0, y1, z0], [x1, y1, z0], [x1, y0, z0]]))
        .with(&quad([[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]]))
        .with(&quad([[x0, y0, z0], [x0, y0, z1], [x0, y1, z1], [x0, y1, z0]]))
        .with(&quad([[x1, y0, z0], [x1, y1, z0], [x1, y1, z1], [x1, y0, z1]]))
}

/// A unit sphere of `20 * 4^levels` triangles: an icosahedron, halved edge by edge. Positions are normals.
pub fn unit_sphere(levels: u32) -> Shape {
    let long = (1.0 + 5.0f64.sqrt()) / 2.0;
    let mut points: Vec<DVec3> = Vec::new();
    for (a, b) in [(-1.0, long), (1.0, long), (-1.0, -long), (1.0, -long)] {
        points.extend([DVec3::new(a, b, 0.0), DVec3::new(0.0, a, b), DVec3::new(b, 0.0, a)]);
    }
    let points: Vec<_> = points.into_iter().map(DVec3::normalize).collect();
    let mut sphere = Subdivision { triangles: hull(&points), points, middles: BTreeMap::new() };
    for _ in 0..levels {
        sphere.halve_edges();
    }
    let positions: Vec<_> = sphere.points.iter().map(|point| point.as_vec3().to_array()).collect();
    Shape { normals: positions.clone(), positions, triangles: sphere.triangles }
}

/// Faces of the icosahedron: every three points at edge distance, turned outwards.
fn hull(points: &[DVec3]) -> Vec<[u32; 3]> {
    let edge =
        points.iter().skip(1).map(|point| point.distance(points[0])).fold(f64::INFINITY, f64::min) * 1.01;
    let near = |a: usize, b: usize| points[a].distance(points[b]) < edge;
    let mut faces = Vec::new();
    for a in 0..points.len() {
        for b in a + 1..points.len() {
            for c in (b + 1..points.len()).filter(|&c| near(a, b) && near(b, c) && near(c, a)) {
                let outward = (points[b] - points[a]).cross(points[c] - points[a]).dot(points[a]) > 0.0;
                let face = if outward { [a, b, c] } else { [a, c, b] };
                faces.push(face.map(|vertex| vertex as u32));
            }
        }
    }
    faces
}

struct Subdivision {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    middles: BTreeMap<(u32, u32), u32>,
}

impl Subdivision {
    fn halve_edges(&mut self) {
        for [a, b, c] in std::mem::take(&mut self.triangles) {
            let (ab, bc, ca) = (self.middle(a, b), self.middle(b, c), self.middle(c, a));
            self.triangles.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
    }

    fn middle(&mut self, a: u32, b: u32) -> u32 {
        let key = (a.min(b), a.max(b));
        if let Some(&middle) = self.middles.get(&key) {
            return middle;
        }
        let point = (self.points[a as usize] + self.points[b as usize]).normalize();
        self.points.push(point);
        let middle = self.points.len() as u32 - 1;
        self.middles.insert(key, middle);
        middle
    }
}

/// A square of `cells` x `cells` x 2 triangles with heights from a function of (x, z), centred at the origin.
pub fn terrain(cells: u32, side: f32, height: impl Fn(f64, f64) -> f64) -> Shape {
    let step = f64::from(side) / f64::from(cells);
    let coordinate = |index: u32| f64::from(index) * step - f64::from(side) / 2.0;
    let mut shape = Shape::default();
    for row in 0..=cells {
        for column in 0..=cells {
            let (x, z) = (coordinate(column), coordinate(row));
            let slope_x = (height(x + step, z) - height(x - step, z)) / (2.0 * step);
            let slope_z = (height(x, z + step) - height(x, z - step)) / (2.0 * step);
            shape.positions.push([x as f32, height(x, z) as f32, z as f32]);
            shape.normals.push(DVec3::new(-slope_x, 1.0, -slope_z).normalize().as_vec3().to_array());
        }
    }
    for row in 0..cells {
        for column in 0..cells {
            let a = row * (cells + 1) + column;
            let (b, c, d) = (a + cells + 1, a + cells + 2, a + 1);
            shape.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    shape
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Volume by the divergence theorem: positive only if every face looks outwards.
    fn volume(shape: &Shape) -> f64 {
        let point = |vertex: u32| Vec3::from(shape.positions[vertex as usize]).as_dvec3();
        shape.triangles.iter().map(|&[a, b, c]| point(a).dot(point(b).cross(point(c))) / 6.0).sum()
    }

    fn assert_normals_follow_the_winding(shape: &Shape) {
        for &[a, b, c] in &shape.triangles {
            let [p, q, r] = [a, b, c].map(|vertex| Vec3::from(shape.positions[vertex as usize]));
            let face = (q - p).cross(r - p);
            for vertex in [a, b, c] {
                assert!(face.dot(Vec3::from(shape.normals[vertex as usize])) > 0.0);
            }
        }
    }

    #[test]
    fn shapes_are_closed_and_face_outwards() {
        let sphere = unit_sphere(3);
        assert_eq!((sphere.positions.len(), sphere.triangles.len()), (642, 1280));
        assert!((volume(&sphere) / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.01);
        let cuboid = cuboid([-1.0, 0.0, 2.0], [1.0, 3.0, 2.5]);
        assert!((volume(&cuboid) - 3.0).abs() < 1e-6);
        for shape in [sphere, cuboid, terrain(9, 4.0, |x, z| (x + z).sin())] {
            assert_normals_follow_the_winding(&shape);
        }
    }
}
