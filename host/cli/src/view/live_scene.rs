//! A picture of the page's format as a scene that Foxglove draws.
//!
//! Entry point: [`LiveScene::picture`]. Tools, needles and threads in every one, the tissue in every second.

use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, LinePrimitive, Point3, Pose, Quaternion, SceneEntity,
    SceneEntityDeletion, SceneUpdate, SpherePrimitive, Timestamp, TriangleListPrimitive, Vector3,
    line_primitive, scene_entity_deletion,
};
use nalgebra::{Quaternion as Turn, Translation3, UnitQuaternion, Vector3 as Vector};
use serde_json::Value;
use sutura_host::picture::{NeedleView, Picture, Read, ThreadView, ToolView};

/// Pictures between two of the tissue.
const TISSUE_EVERY: u32 = 2;
const FRAME: &str = "world";
const TISSUE: Color = colour(0.91, 0.47, 0.41);
const TOOL: Color = colour(0.70, 0.74, 0.80);
const NEEDLE: Color = colour(0.85, 0.87, 0.90);
const THREAD: Color = colour(0.20, 0.45, 0.85);

const fn colour(r: f64, g: f64, b: f64) -> Color {
    Color { r, g, b, a: 1.0 }
}

/// What is known of a session besides its pictures.
#[derive(Default)]
pub struct LiveScene {
    hello: Value,
    points_m: Vec<[f64; 3]>,
    indices: Vec<u32>,
    /// Whether what was drawn before is another scene's.
    pub is_new: bool,
    count: u32,
}

fn xyz([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

fn point([x, y, z]: [f64; 3]) -> Point3 {
    Point3 { x, y, z }
}

fn pose(at: [f64; 3], [x, y, z, w]: [f64; 4]) -> Option<Pose> {
    Some(Pose {
        position: Some(xyz(at)),
        orientation: Some(Quaternion { x, y, z, w }),
    })
}

fn points(value: &Value) -> Vec<[f64; 3]> {
    let all = value.as_array().into_iter().flatten();
    all.filter_map(vector).collect()
}

fn vector(value: &Value) -> Option<[f64; 3]> {
    let list: Vec<f64> = value
        .as_array()?
        .iter()
        .map(|x| x.as_f64())
        .collect::<Option<_>>()?;
    list.try_into().ok()
}

/// The entry of a list that has this `id`.
fn of(list: &Value, id: u8) -> &Value {
    let mut all = list.as_array().into_iter().flatten();
    all.find(|each| each["id"] == id).unwrap_or(&Value::Null)
}

impl LiveScene {
    /// A session begins, or is said anew.
    pub fn hello(&mut self, said: &Value) {
        self.is_new |= said["session"] != self.hello["session"];
        self.hello = said.clone();
    }

    /// The unloaded tissue.
    pub fn geometry(&mut self, bytes: &[u8]) {
        if let Some(read) = Read::of(bytes) {
            self.points_m = read.vectors(1);
            self.indices = read.triples(2).concat();
        }
    }

    /// A picture's number and what it shows; none if it is no picture.
    pub fn picture(&mut self, bytes: &[u8]) -> Option<(u32, SceneUpdate)> {
        let picture = Picture::read(bytes)?;
        let now = Some(Timestamp::now());
        let mut deletions = Vec::new();
        if std::mem::take(&mut self.is_new) {
            self.count = 0;
            deletions.push(SceneEntityDeletion {
                timestamp: now,
                r#type: scene_entity_deletion::Type::All.into(),
                id: String::new(),
            });
        }
        let mut entities: Vec<SceneEntity> = Vec::new();
        entities.extend(picture.tools.iter().filter_map(|tool| self.tool(tool)));
        entities.extend(picture.needles.iter().map(|needle| self.needle(needle)));
        entities.extend(picture.threads.iter().map(|thread| self.thread(thread)));
        if self.count.is_multiple_of(TISSUE_EVERY) {
            entities.push(self.tissue(&picture));
        }
        self.count = self.count.wrapping_add(1);
        for entity in &mut entities {
            (entity.timestamp, entity.frame_id) = (now, FRAME.to_owned());
        }
        let update = SceneUpdate {
            deletions,
            entities,
        };
        Some((picture.sequence, update))
    }

    fn tissue(&self, picture: &Picture) -> SceneEntity {
        let moved = self.points_m.iter().zip(&picture.displacement_m);
        let moved = moved.map(|(at, by)| point([0, 1, 2].map(|axis: usize| at[axis] + by[axis])));
        let triangles = TriangleListPrimitive {
            pose: pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]),
            points: moved.collect(),
            color: Some(TISSUE),
            colors: Vec::new(),
            indices: self.indices.clone(),
        };
        SceneEntity {
            id: "tissue".to_owned(),
            triangles: vec![triangles],
            ..SceneEntity::default()
        }
    }

    fn tool(&self, tool: &ToolView) -> Option<SceneEntity> {
        let said = of(&self.hello["tools"], tool.id);
        let number = |key: &str| said[key].as_f64().unwrap_or_default();
        let axis = Vector::from(vector(&said["axis"]).unwrap_or([0.0, 0.0, -1.0]));
        let side = Vector::from(vector(&said["side"]).unwrap_or([1.0, 0.0, 0.0]));
        let [x, y, z, w] = tool.orientation;
        let turned = UnitQuaternion::from_quaternion(Turn::new(w, x, y, z));
        // Its own frame: x along the side, z against the axis.
        let across = (-axis).cross(&side);
        let own = nalgebra::Matrix3::from_columns(&[side, across, -axis]);
        let own = turned * UnitQuaternion::from_matrix(&own);
        let own_turn = <[f64; 4]>::from(own.coords);
        // What stands behind the shape's own point by so much.
        let behind = |length_m: f64| {
            let at = Translation3::from(tool.position_m).vector + own * Vector::z() * length_m;
            pose(at.into(), own_turn)
        };
        let radius_m = number("radius_m");
        let ball = |at: Option<Pose>| SpherePrimitive {
            pose: at,
            size: Some(xyz([2.0 * radius_m; 3])),
            color: Some(TOOL),
        };
        let rod = |length_m: f64| CylinderPrimitive {
            pose: behind(0.5 * length_m),
            size: Some(xyz([2.0 * radius_m, 2.0 * radius_m, length_m])),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color: Some(TOOL),
        };
        let mut entity = SceneEntity {
            id: format!("tool {}", tool.id),
            ..SceneEntity::default()
        };
        match said["shape"].as_str()? {
            "sphere" => entity.spheres.push(ball(behind(0.0))),
            "capsule" => {
                let length_m = number("length_m");
                entity.spheres = vec![ball(behind(0.0)), ball(behind(length_m))];
                entity.cylinders.push(rod(length_m));
            }
            "punch" => entity.cylinders.push(rod(number("length_m"))),
            "box" => {
                let size_m = vector(&said["size_m"])?;
                entity.cubes.push(CubePrimitive {
                    pose: behind(0.5 * size_m[2]),
                    size: Some(xyz(size_m)),
                    color: Some(TOOL),
                });
            }
            "mesh" => {
                let indices = said["triangles"]
                    .as_array()?
                    .iter()
                    .flat_map(Value::as_array);
                let indices = indices.flatten().filter_map(Value::as_u64);
                entity.triangles.push(TriangleListPrimitive {
                    pose: behind(0.0),
                    points: points(&said["points_m"]).into_iter().map(point).collect(),
                    color: Some(TOOL),
                    colors: Vec::new(),
                    indices: indices.filter_map(|index| index.try_into().ok()).collect(),
                });
            }
            _ => return None,
        }
        Some(entity)
    }

    fn needle(&self, needle: &NeedleView) -> SceneEntity {
        let said = of(&self.hello["needles"], needle.id);
        let line = LinePrimitive {
            pose: pose(needle.position_m, needle.orientation),
            thickness: said["thickness_m"].as_f64().unwrap_or_default(),
            points: points(&said["points_m"]).into_iter().map(point).collect(),
            ..strip(NEEDLE)
        };
        SceneEntity {
            id: format!("needle {}", needle.id),
            lines: vec![line],
            ..SceneEntity::default()
        }
    }

    fn thread(&self, thread: &ThreadView) -> SceneEntity {
        let said = of(&self.hello["threads"], thread.id);
        let line = LinePrimitive {
            thickness: 2.0 * said["radius_m"].as_f64().unwrap_or_default(),
            points: thread.points.iter().map(|each| point(each.at_m)).collect(),
            ..strip(THREAD)
        };
        SceneEntity {
            id: format!("thread {}", thread.id),
            lines: vec![line],
            ..SceneEntity::default()
        }
    }
}

fn strip(color: Color) -> LinePrimitive {
    LinePrimitive {
        r#type: line_primitive::Type::LineStrip.into(),
        pose: pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]),
        color: Some(color),
        ..LinePrimitive::default()
    }
}
