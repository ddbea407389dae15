//! What a frame uses, and what was left out because it does not.

use super::PreparedScene;
use farm_scene::{Filter, Material, Surface};
use serde::Serialize;

/// One feature of the renderer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Usage {
    /// What it is.
    pub feature: &'static str,
    /// How many things use it; 0 means that nothing is paid for it.
    pub count: u64,
}

/// What a prepared frame consists of.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Triangles as drawn, every instance counted.
    pub triangles: u64,
    /// Triangles in memory.
    pub triangles_stored: u64,
    /// Bytes of the acceleration structure.
    pub accel_bytes: u64,
    /// Instances of meshes.
    pub instances: u64,
    /// Triangles left out because a coordinate is not finite.
    pub dropped_not_finite: u64,
    /// Triangles left out because they have no area.
    pub dropped_no_area: u64,
    /// Instances left out because their place is not finite or flattens them away.
    pub dropped_instances: u64,
    /// Instances, those that are left out included, that their place flattens or puts nowhere.
    pub flattened_instances: u64,
    /// Features in a fixed order.
    pub features: Vec<Usage>,
}

impl Report {
    /// Features that the frame uses.
    pub fn used(&self) -> impl Iterator<Item = &Usage> {
        self.features.iter().filter(|usage| usage.count > 0)
    }

    /// Features that were left out.
    pub fn left_out(&self) -> impl Iterator<Item = &'static str> {
        self.features.iter().filter(|usage| usage.count == 0).map(|usage| usage.feature)
    }
}

pub(super) fn of(prepared: &PreparedScene) -> Report {
    let scene = &*prepared.scene;
    let lights = prepared.lights.report();
    let drawn = &prepared.drawn;
    let materials_with = |has: &dyn Fn(&Material) -> bool| {
        drawn.iter().filter(|drawn| has(&scene.materials[drawn.material as usize])).count() as u64
    };
    let accel = prepared.world.accel.report();
    let features = [
        ("motion blur", u64::from(prepared.is_moving)),
        ("moving camera", u64::from(prepared.camera.is_moving())),
        ("deforming meshes", prepared.deformed.len() as u64),
        ("depth of field", u64::from(prepared.camera.has_lens())),
        ("two-level traversal", u64::from(accel.levels > 1)),
        ("cutouts and blending", drawn.iter().filter(|drawn| drawn.cutout).count() as u64),
        ("textures", scene.textures.len() as u64),
        ("normal maps", materials_with(&|material| material.normal_map.is_some())),
        ("mirrors", materials_with(&|material| matches!(material.surface, Surface::Mirror(_)))),
        ("transmission", materials_with(&transmits)),
        ("volumes", materials_with(&|material| material.volume.is_some())),
        ("emissive triangles", lights.triangles),
        ("sphere lights", lights.spheres),
        ("rectangle lights", lights.rectangles),
        ("disk lights", lights.disks),
        ("point lights", lights.points),
        ("spot lights", lights.spots),
        ("directional lights", lights.directionals),
        ("light tree", lights.tree_nodes),
        ("environment", u64::from(lights.environment)),
        ("pixel filter", u64::from(prepared.settings.filter != Filter::Box)),
    ];
    let triangles = |drawn: &super::Drawn| scene.meshes[drawn.mesh as usize].triangles.len() as u64;
    Report {
        triangles: drawn.iter().map(triangles).sum(),
        triangles_stored: accel.triangles as u64,
        accel_bytes: (accel.node_bytes + accel.triangle_bytes) as u64,
        instances: drawn.len() as u64,
        dropped_not_finite: accel.dropped_not_finite as u64,
        dropped_no_area: accel.dropped_no_area as u64,
        dropped_instances: accel.dropped_instances as u64,
        flattened_instances: accel.flattened_instances as u64,
        features: features.map(|(feature, count)| Usage { feature, count }).to_vec(),
    }
}

fn transmits(material: &Material) -> bool {
    matches!(material.surface, Surface::MetallicRoughness { dielectric, .. } if dielectric.transmission.is_some())
}
