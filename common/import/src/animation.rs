//! The chosen animation's channels.

use crate::accessor::{Accessors, Reader};
use crate::error::{Fault, Place};
use crate::node::Selection;
use crate::report::Warnings;
use farm_scene::{Channel, Interpolation, Path};
use glam::{Quat, Vec3};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::animation::{Interpolation as FileInterpolation, Property};
use gltf::json::validation::Checked;
use gltf::json::{Animation, Root};
use std::collections::BTreeSet;

/// What each of the file's animations is called.
pub(crate) fn names(root: &Root) -> Vec<String> {
    let name = |(index, animation): (usize, &Animation)| {
        animation.name.clone().filter(|name| !name.is_empty()).unwrap_or_else(|| format!("animation {index}"))
    };
    root.animations.iter().enumerate().map(name).collect()
}

/// The number of the animation called `wanted`; without a wish, the first.
pub(crate) fn choose(root: &Root, wanted: Option<&str>, warnings: &Warnings) -> Result<Option<usize>, Fault> {
    let names = names(root);
    match wanted {
        Some(wanted) => {
            let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            let found = names.iter().position(|name| name == wanted);
            let missing = || Fault::whole(format!("has no animation {wanted:?}; it has: {known}"));
            found.map(Some).ok_or_else(missing)
        }
        None => {
            if names.len() > 1 {
                let others = names[1..].join(", ");
                warnings.add(
                    &"animations",
                    format!("only {:?} is played; choose another by name: {others}", names[0]),
                );
            }
            Ok((!names.is_empty()).then_some(0))
        }
    }
}

/// Number of morph targets of each of the file's nodes.
pub(crate) fn morph_targets_of(root: &Root, node: usize) -> usize {
    let mesh = root.nodes[node].mesh.map(|mesh| &root.meshes[mesh.value()]);
    let primitive = mesh.and_then(|mesh| mesh.primitives.first());
    primitive.and_then(|primitive| primitive.targets.as_ref()).map_or(0, Vec::len)
}

/// Reads the channels of animation `index` that move imported nodes.
pub(crate) fn read(
    root: &Root,
    index: usize,
    accessors: &Accessors,
    selection: &Selection,
    warnings: &Warnings,
) -> Result<Vec<Channel>, Fault> {
    let animation = &root.animations[index];
    let place = Place::new("animation", index, animation.name.as_deref());
    let mut channels: Vec<Channel> = vec![];
    let mut moved = BTreeSet::new();
    for (index, channel) in animation.channels.iter().enumerate() {
        let place = place.then("channel", index, None);
        let target = channel.target.node.value();
        let Some(node) = selection.numbers[target] else { continue };
        let Checked::Valid(property) = channel.target.path else {
            warnings.add(&place, "moves a property that glTF 2.0 does not know, which stays still");
            continue;
        };
        let sampler = &animation.samplers[channel.sampler.value()];
        let sampler = Sampler { sampler, accessors, place: &place };
        let targets = morph_targets_of(root, target);
        if property == Property::MorphTargetWeights && targets == 0 {
            warnings.add(&place, "moves weights of a mesh without morph targets; ignored");
            continue;
        }
        if !moved.insert((node, property as u8)) {
            warnings.add(&place, "moves what an earlier channel moves; ignored");
            continue;
        }
        channels.push(sampler.read(node, property, targets)?);
    }
    Ok(channels)
}

struct Sampler<'a> {
    sampler: &'a gltf::json::animation::Sampler,
    accessors: &'a Accessors<'a>,
    place: &'a Place<'a>,
}

impl Sampler<'_> {
    fn read(&self, node: u32, property: Property, targets: usize) -> Result<Channel, Fault> {
        let Checked::Valid(interpolation) = self.sampler.interpolation else {
            return Err(self.place.fault("has an interpolation other than STEP, LINEAR or CUBICSPLINE"));
        };
        let (interpolation, per_key) = match interpolation {
            FileInterpolation::Step => (Interpolation::Step, 1),
            FileInterpolation::Linear => (Interpolation::Linear, 1),
            FileInterpolation::CubicSpline => (Interpolation::CubicSpline, 3),
        };
        let times = self.times()?;
        let values = times.len() as u64 * per_key;
        let path = match property {
            Property::Translation => Path::Translation(self.vectors(values)?),
            Property::Scale => Path::Scale(self.vectors(values)?),
            Property::Rotation => Path::Rotation(self.rotations(values, per_key == 3)?),
            Property::MorphTargetWeights => Path::MorphWeights {
                targets: targets as u32,
                values: self.weights(values.saturating_mul(targets as u64))?,
            },
        };
        Ok(Channel { node, times, interpolation, path })
    }

    fn times(&self) -> Result<Vec<f32>, Fault> {
        let place = self.place.field("input");
        let reader = self.accessors.reader(self.sampler.input, &[Type::Scalar], &place)?;
        let floats = matches!(reader.component(), ComponentType::F32);
        place.ensure(floats && reader.count() > 0, || "must hold at least one time, as floats".to_owned())?;
        self.accessors.charge(reader.count() as u64, &place)?;
        let times: Vec<f32> = (0..reader.count()).map(|key| reader.floats::<1>(key)[0]).collect();
        let increasing =
            times.windows(2).all(|pair| pair[0] < pair[1]) && times.iter().all(|time| time.is_finite());
        place.ensure(increasing, || "has key times that do not increase".to_owned())?;
        Ok(times)
    }

    fn values(&self, wanted: u64, kind: Type) -> Result<Reader<'_>, Fault> {
        let place = self.place.field("output");
        let reader = self.accessors.reader(self.sampler.output, &[kind], &place)?;
        let held = reader.count() as u64;
        place.ensure(held == wanted, || format!("has {held} values where the keys ask for {wanted}"))?;
        self.accessors.charge(wanted, &place)?;
        Ok(reader.normalized())
    }

    fn finite(&self, finite: bool) -> Result<(), Fault> {
        self.place.field("output").ensure(finite, || "has values that are not finite".to_owned())
    }

    fn vectors(&self, wanted: u64) -> Result<Vec<Vec3>, Fault> {
        let reader = self.values(wanted, Type::Vec3)?;
        let vectors: Vec<Vec3> =
            (0..reader.count()).map(|key| Vec3::from_array(reader.floats(key))).collect();
        self.finite(vectors.iter().all(|vector| vector.is_finite()))?;
        Ok(vectors)
    }

    fn weights(&self, wanted: u64) -> Result<Vec<f32>, Fault> {
        let reader = self.values(wanted, Type::Scalar)?;
        let weights: Vec<f32> = (0..reader.count()).map(|key| reader.floats::<1>(key)[0]).collect();
        self.finite(weights.iter().all(|weight| weight.is_finite()))?;
        Ok(weights)
    }

    /// Unit quaternions; the tangents of a spline are left as they are.
    fn rotations(&self, wanted: u64, spline: bool) -> Result<Vec<Quat>, Fault> {
        let reader = self.values(wanted, Type::Vec4)?;
        let rotation = |key: usize| {
            let rotation = Quat::from_array(reader.floats(key));
            let is_value = !spline || key % 3 == 1;
            if is_value { normalize(rotation) } else { rotation }
        };
        let rotations: Vec<Quat> = (0..reader.count()).map(rotation).collect();
        self.finite(rotations.iter().all(|rotation| rotation.is_finite()))?;
        Ok(rotations)
    }
}

/// In f64, where no quaternion over- or underflows.
fn normalize(rotation: Quat) -> Quat {
    let wide = rotation.to_array().map(f64::from);
    let length = wide.iter().map(|component| component * component).sum::<f64>().sqrt();
    Quat::from_array(wide.map(|component| (component / length) as f32))
}
