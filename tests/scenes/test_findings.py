"""What is said of a scene before anything is sampled: each wrong scene gets its finding, a right one none."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import dexnudge as dn
from dexnudge.scenes.boxes import box
from dexnudge.scenes.room import thinnest_digit

FLAT = trimesh.creation.box((0.15, 0.07, 0.008))
UPSIDE_DOWN = trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0])
TABLE = box((-0.6, -0.4, -0.04), (0.6, 0.4, 0.0))


def at(x=0.0, y=0.0, z=0.004):
    return trimesh.transformations.translation_matrix((x, y, z))


def moved(mesh, place):
    return mesh.copy().apply_translation(place)


def scene_of(environment=TABLE, pose=None, motion=(1.0, 0.0, 0.0), **values):
    return dn.Scene(FLAT, environment, at() if pose is None else pose, np.array(motion), **values)


def said(scene, what, hand=None):
    """The findings about one thing that are no notes."""
    return [each for each in scene.findings(hand) if each.what == what and each.level != "note"]


def test_a_finding_reads_as_one_line():
    finding = dn.Finding("warning", "size", "the object weighs 150 kg", "give `mass` in kg")
    assert str(finding) == "warning: the object weighs 150 kg; give `mass` in kg"
    assert finding.as_dict() == {
        "level": "warning",
        "what": "size",
        "sentence": "the object weighs 150 kg",
        "remedy": "give `mass` in kg",
    }
    assert str(dn.Finding("note", "size", "it is small")) == "note: it is small"


@pytest.mark.parametrize("family", dn.scene_families())
@pytest.mark.parametrize("name", ["phone", "book"])
def test_built_in_scenes_raise_no_alarm(family, name, shadow_hand):
    found = dn.build_scene(family, name, seed=1).findings(shadow_hand)
    assert [str(finding) for finding in found if finding.level != "note"] == []
    assert found[0].sentence.startswith("the object is ")


def test_surroundings_in_millimetres_name_the_unit():
    table = TABLE.copy().apply_scale(1000)
    (finding,) = said(scene_of(table), "units")
    assert finding.level == "error"
    assert finding.message == (
        "the surroundings are 1200 m wide; expected at most 12 m, as a room has; is it in another unit? "
        "pass `units` cm (12 m) or mm (1.2 m)"
    )


def test_surroundings_in_metres_beside_an_object_in_millimetres_are_asked_about():
    shrunk = TABLE.copy().apply_scale(0.001)  # both were read in millimetres
    (finding,) = said(scene_of(shrunk), "units")
    assert finding.level == "error"
    assert finding.remedy == ("is it in metres, not mm (1.2 m)? `units` is of both meshes: write them in the same one")


def test_surroundings_in_centimetres_are_asked_about():
    (finding,) = said(scene_of(box((-15.0, -10.0, -1.0), (15.0, 10.0, 0.0))), "units")
    assert (finding.level, "cm (0.3 m)" in finding.remedy) == ("warning", True)


def test_a_mass_in_grams_is_asked_about():
    (finding,) = said(scene_of(mass=150.0), "size")
    assert (finding.level, finding.remedy) == ("warning", "give `mass` in kg")


def test_a_pose_inside_a_wall_is_an_error_with_the_way_out():
    wall = trimesh.util.concatenate([TABLE, box((0.072, -0.2, 0.0), (0.1, 0.2, 0.1))])
    (finding,) = said(scene_of(wall), "pose")
    assert finding.level == "error"
    assert finding.sentence.startswith("the environment already penetrates the object by 3.0 mm near (0.07")
    assert "by (-0.0030, 0.0000, 0.0000) m in the world" in finding.remedy
    with pytest.raises(dn.SceneError) as caught:
        scene_of(wall).validate()
    assert str(caught.value) == finding.message


@pytest.mark.parametrize(
    ("turn", "pose", "question"),
    [
        (np.eye(4), at(100, 50, 4), "in millimetres?"),
        (UPSIDE_DOWN, at(), "upside down?"),
        (trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]), at(), "y-up?"),
        (np.eye(4), np.linalg.inv(trimesh.transformations.rotation_matrix(1.0, [0, 0, 1]) @ at(0.1, 0.2)), "inverted?"),
    ],
)
def test_a_common_mistake_is_named(turn, pose, question):
    (finding,) = said(scene_of(TABLE.copy().apply_transform(turn), pose), "pose")
    assert finding.level == "error"
    assert question in finding.remedy


def test_an_object_under_a_sheet_is_not_asked_about_axes():
    sheet = trimesh.Trimesh([[-0.3, -0.3, 0], [0.3, -0.3, 0], [0.3, 0.3, 0], [-0.3, 0.3, 0]], [[0, 1, 2], [0, 2, 3]])
    (finding,) = said(scene_of(sheet, at(z=-0.02)), "pose")
    assert finding.sentence.startswith("the object touches nothing: the nearest surface is 16.0 mm above it")
    assert finding.remedy == "move the object by (0.0000, 0.0000, 0.0160) m in the world"


def test_room_is_told_for_each_side(shadow_hand):
    above = box((-0.6, -0.4, 0.020), (0.6, 0.4, 0.04))
    beside = box((-0.6, 0.065, 0.0), (0.6, 0.1, 0.02))
    scene = scene_of(trimesh.util.concatenate([TABLE, above, beside]))
    (finding,) = [each for each in scene.findings() if each.what == "clearance"]
    assert finding.sentence == "room around the object: in front free, behind free, left 30 mm, right free, above 12 mm"


def test_a_gap_that_no_finger_enters_is_an_error(shadow_hand):
    need = thinnest_digit(shadow_hand)
    assert 0.008 < need < 0.02
    for gap, level in ((0.003, "error"), (0.8 * need, "warning")):
        around = box((-0.075 - gap, -0.035 - gap, 0.0), (0.075 + gap, 0.035 + gap, 0.008 + gap))
        around.invert()  # the object in a closed box: the gap is the same on all sides
        cave = trimesh.util.concatenate([around, box((-0.2, -0.2, -0.1), (0.2, 0.2, 0.1))])
        (finding,) = said(scene_of(cave), "fingers", shadow_hand)
        assert finding.level == level
        assert f"the largest gap around the object is {1e3 * gap:.1f} mm" in finding.sentence


def test_what_was_repaired_is_a_note(tmp_path):
    TABLE.submesh([[face for face, normal in enumerate(TABLE.face_normals) if normal[2] > 0.5]])[0].export(
        tmp_path / "sheet.ply"
    )
    scene = scene_of(dn.load_environment(tmp_path / "sheet.ply"))
    scene = replace(scene, environment_mesh=scene.environment_mesh)
    assert [each.sentence for each in scene.findings() if each.what == "repaired"] == scene.notes


@pytest.mark.parametrize(
    ("places", "sentence"),
    [
        ([(0.0, 0.09, 0.0)], ""),  # 20 of 160 mm, but a bridge between them
        ([(0.0, 0.11, 0.0)], "a part of the object lies 40.0 mm away from the rest, 22% of its length"),
        (
            [(0.0, 0.11, 0.0), (0.0, 0.22, 0.0)],
            "2 parts of the object lie 40.0 mm away from the rest, 14% of its length",
        ),
    ],
)
def test_parts_that_lie_far_apart_are_a_warning(places, sentence):
    bridge = [moved(box((-0.01, 0.04, 0.0), (0.01, 0.05, 0.008)), (0, 0, -0.004))] if not sentence else []
    others = [moved(FLAT, place) for place in places]
    both = dn.Scene(trimesh.util.concatenate([FLAT, *bridge, *others]), TABLE, at(), np.array([1.0, 0, 0]))
    found = [str(each) for each in both.findings() if "away from the rest" in each.sentence]
    remedy = "; they count as one body; if they are several things, leave one of them in the mesh"
    assert found == ([f"warning: {sentence}{remedy}"] if sentence else [])


def test_the_free_way_is_told():
    (finding,) = [each for each in scene_of().findings() if each.what == "free_way"]
    assert (finding.level, finding.sentence) == ("note", "the way along (1.00, 0.00, 0.00) is free for 100 mm")


def test_an_obstacle_in_the_way_is_an_error_with_a_shorter_and_other_motions():
    rib = box((0.116, -0.2, -0.01), (0.126, 0.2, 0.006))
    (finding,) = said(scene_of(trimesh.util.concatenate([TABLE, rib])), "free_way")
    assert finding.level == "error"
    assert "is blocked after 41 mm by something 6 mm high at (0.116, " in finding.sentence
    assert finding.sentence.endswith("; expected 100 mm")
    assert finding.remedy.startswith(
        "shorten `motion_length` to 0.04, or choose another `motion`: (0.00, 1.00, 0.00), "
    )
    shorter = replace(scene_of(trimesh.util.concatenate([TABLE, rib])), motion_length=0.04)
    assert said(shorter, "free_way") == []


def test_a_wall_in_the_way_at_once_is_an_error():
    wall = trimesh.util.concatenate([TABLE, box((0.075, -0.2, 0.0), (0.1, 0.2, 0.1))])
    (finding,) = said(scene_of(wall), "free_way")
    assert finding.level == "error"
    assert "blocked by what it touches at (0.075, " in finding.sentence
    assert finding.remedy.startswith("choose another `motion`: (0.00, 1.00, 0.00), ")
    assert "(1.00, 0.00, 0.00)" not in finding.remedy


@pytest.mark.parametrize(("motion", "degrees"), [((0.0, 0.0, -1.0), 90), ((1.0, 0.0, -1.0), 45)])
def test_a_motion_into_the_support_is_an_error(motion, degrees):
    (finding,) = said(scene_of(motion=motion), "motion")
    assert finding.level == "error"
    assert f"leads {degrees} degrees into what carries the object; expected one along it" in finding.sentence
    assert "are free" in finding.remedy


def test_a_motion_off_the_support_is_a_warning():
    (finding,) = said(scene_of(motion=(0.0, 0.0, 1.0)), "motion")
    assert (finding.level, finding.remedy) == ("warning", "give a `motion` along the support")
    assert "at 90 degrees" in finding.sentence


def test_an_object_under_a_table_is_not_carried():
    (finding,) = said(scene_of(box((-0.6, -0.4, 0.008), (0.6, 0.4, 0.048))), "carried")
    assert finding.level == "error"
    assert "what it touches is above it" in finding.sentence
    assert finding.remedy.startswith("is the scan upside down?")


def test_an_object_against_a_wall_alone_is_not_carried():
    (finding,) = said(scene_of(box((-0.5, 0.035, -0.5), (0.5, 0.1, 0.5))), "carried")
    assert finding.level == "error"
    assert "what it touches is beside it" in finding.sentence


def test_an_object_beyond_the_edge_would_tip():
    assert said(scene_of(box((-0.6, -0.4, -0.04), (0.005, 0.4, 0.0))), "carried") == []
    (finding,) = said(scene_of(box((-0.6, -0.4, -0.04), (-0.03, 0.4, 0.0))), "carried")
    assert finding.level == "warning"
    assert "is 30.0 mm outside of what carries it" in finding.sentence


def test_what_was_never_seen_is_told():
    surroundings = trimesh.util.concatenate([TABLE, box((-0.05, 0.05, 0.0), (0.05, 0.06, 0.1))])
    surroundings.metadata["origin"] = np.repeat([0, 2], 12)
    (finding,) = [each for each in scene_of(surroundings).findings() if each.what == "seen"]
    unseen = 0.1 * 0.1 * 2 + 0.1 * 0.01 * 4
    seen = 2 * (1.2 * 0.8 + 1.2 * 0.04 + 0.8 * 0.04) - 2 * 0.04 * 0.8  # both ends are out of reach
    share = unseen / (seen + unseen)
    assert finding.sentence == (
        f"of the surface around object and way {1 - share:.0%} was seen, 0% is assumed, {share:.0%} bounds what was not seen"
    )


RAISED = "the object stood 0.5 mm inside what carries it, and was raised"
LOWERED = "the object touched nothing: the nearest surface was 3.0 mm below it, and it was lowered"


@pytest.mark.parametrize(("height", "level", "sentence"), [(0.0035, "note", RAISED), (0.007, "warning", LOWERED)])
def test_an_object_that_was_settled_is_told(height, level, sentence):
    scene = dn.Scene.from_files(FLAT, environment=TABLE, object_pose=at(z=height), motion=[1, 0, 0])
    (finding,) = [each for each in scene.findings() if each.what == "settled"]
    assert (finding.level, finding.sentence) == (level, f"{sentence} onto it")
    assert not [each for each in scene.findings() if each.what == "repaired"]
    assert ("`settle` off" in finding.remedy) == (level == "warning")


def test_supports_are_told_with_tilt_area_and_noise():
    tilt = trimesh.transformations.rotation_matrix(np.radians(2.0), [0, 1, 0])
    small = box((-0.3, -0.2, -0.04), (0.3, 0.2, 0.0))
    table = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(small.vertices, small.faces, 0.01))
    table.vertices[:, 2] += np.random.default_rng(0).normal(0.0, 5e-4, len(table.vertices))
    scene = dn.Scene.from_files(
        FLAT, environment=table.apply_transform(tilt), object_pose=tilt @ at(), motion=[1, 0, 0]
    )
    supports = [each.sentence for each in scene.findings() if each.what == "supports"]
    assert supports[0].startswith("a plane below the object at (")
    assert "2.0 degrees from level, contact area " in supports[0]
    assert float(supports[0].split("noise ")[1].removesuffix(" mm")) == pytest.approx(0.5, abs=0.1)
    assert supports[-1] == "the surfaces scatter by 0.5 mm: hands keep 0.5 mm clear"


def test_a_rough_scan_upside_down_is_recognised():
    small = box((-0.2, -0.2, -0.04), (0.2, 0.2, 0.0))
    table = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(small.vertices, small.faces, 0.01))
    table.vertices[:, 2] += np.random.default_rng(0).normal(0.0, 1e-3, len(table.vertices))
    turned = table.copy().apply_transform(UPSIDE_DOWN)
    options = {"motion": [1, 0, 0], "validate": False}
    (finding,) = said(dn.Scene.from_files(FLAT, environment=turned, object_pose=at(), **options), "pose")
    assert "is the scan upside down?" in finding.remedy
    both = dn.Scene.from_files(FLAT, environment=turned, object_pose=UPSIDE_DOWN @ at(), **options)
    assert [each.what for each in both.findings() if each.level == "error"] == ["carried"]


def test_an_object_that_floats_is_not_asked_for_its_unit():
    (finding,) = said(scene_of(pose=at(0.1, 0.2, 0.012)), "pose")
    assert finding.remedy == "move the object by (0.0000, 0.0000, -0.0080) m in the world"


def test_an_object_that_is_far_too_high_gets_the_plain_shift():
    for height, pose in ((0.3, at(z=0.304)), (0.5, at(0.01, 0.02, 0.504))):
        (finding,) = said(scene_of(pose=pose), "pose")
        assert finding.remedy == f"move the object by (0.0000, 0.0000, -{height:.4f}) m in the world"


def test_a_turned_pose_that_is_too_high_is_not_called_transposed():
    tilt = trimesh.transformations.rotation_matrix(np.radians(2.0), [0, 1, 0])
    (finding,) = said(scene_of(TABLE.copy().apply_transform(tilt), tilt @ at(z=0.0115)), "pose")
    assert finding.remedy.startswith("move the object by (")


def test_a_mistake_comes_with_the_plain_shift():
    (finding,) = said(scene_of(pose=at(100, 50, 4)), "pose")
    assert "in millimetres?" in finding.remedy
    assert "; if not, move the object by (-99" in finding.remedy


@pytest.mark.parametrize("flipped", [False, True])
def test_an_object_deep_in_a_sheet_is_moved_up(flipped):
    sheet = trimesh.Trimesh([[-0.3, -0.3, 0], [0.3, -0.3, 0], [0.3, 0.3, 0], [-0.3, 0.3, 0]], [[0, 1, 2], [0, 2, 3]])
    if flipped:
        sheet.invert()
    thick = trimesh.creation.box((0.16, 0.075, 0.018))
    scene = dn.Scene.from_files(thick, environment=sheet, object_pose=at(z=-0.003), motion=[1, 0, 0], validate=False)
    (finding,) = said(scene, "pose")
    assert finding.remedy == "move the object away from that surface by (0.0000, 0.0000, 0.0120) m in the world"


def test_a_motion_length_in_millimetres_is_asked_about():
    with pytest.raises(dn.SceneError, match="expected at most 2 m; is it in millimetres"):
        scene_of(motion_length=100.0)


@pytest.mark.parametrize(("x", "carried"), [(0.55, 50), (0.3, None)])
def test_an_object_that_leaves_its_support_on_the_way_is_told(x, carried):
    notes = [each.sentence for each in scene_of(pose=at(x=x)).findings() if "centre of mass" in each.sentence]
    assert [int(note.split()[1]) for note in notes] == pytest.approx([carried] if carried else [], abs=7)
    assert all("is beyond what carries it; `execute` stops before" in note for note in notes)


def test_heavy_objects_are_told_in_kilograms():
    sentences = [each.sentence for each in scene_of(mass=150.0).findings()]
    assert "the object is 150 x 70 x 8 mm, 150 kg" in sentences


def scan(generator, hole=None, spacing=0.01, noise=3e-4):
    """A sheet of 0.4 x 0.3 m that scatters, without what is within the box `hole`."""
    sheet = trimesh.Trimesh(
        [[-0.2, -0.15, 0], [0.2, -0.15, 0], [0.2, 0.15, 0], [-0.2, 0.15, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    sheet = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(sheet.vertices, sheet.faces, spacing))
    if hole is not None:
        sheet.update_faces(~(np.abs(sheet.triangles[:, :, :2]) < hole).all(axis=2).any(axis=1))
        sheet.remove_unreferenced_vertices()
    sheet.vertices[:, 2] += generator.normal(0.0, noise, len(sheet.vertices))
    return sheet


def test_a_hole_where_the_object_lay_is_closed_by_the_plane_around_it():
    sheet = scan(np.random.default_rng(0), hole=(0.085, 0.045))
    scene = dn.Scene.from_files(FLAT, environment=sheet, object_pose=at(z=0.0045), motion=[1, 0, 0])
    found = scene.findings()
    assert [str(each) for each in found if each.level != "note"] == []
    assert any("nothing was measured below the object" in each.sentence for each in found)
    beside = dn.Scene.from_files(FLAT, environment=sheet, object_pose=at(y=0.4), motion=[1, 0, 0], validate=False)
    assert len(beside.environment_mesh.faces) == len(sheet.faces)


def test_an_object_too_thin_to_be_told_from_what_carries_it_is_not_said_to_be_scanned():
    thin = trimesh.creation.box((0.15, 0.07, 1e-4))
    pose, table = at(z=5e-5), scan(np.random.default_rng(0), noise=0.0)
    scene = dn.Scene.from_files(thin, environment=table, object_pose=pose, motion=[1, 0, 0], validate=False)
    (finding,) = said(scene, "pose")
    assert finding.sentence == "the object is 0.1 mm high as it lies; expected more than 2 mm"
    assert "thicken its mesh" in finding.remedy


def test_an_object_that_was_scanned_too_is_told():
    thick = trimesh.creation.box((0.15, 0.07, 0.02))
    both = trimesh.util.concatenate([scan(np.random.default_rng(0)), thick.copy().apply_transform(at(z=0.01))])
    scene = dn.Scene.from_files(thick, environment=both, object_pose=at(z=0.01), motion=[1, 0, 0], validate=False)
    (finding,) = said(scene, "pose")
    assert "of the object's upper side coincides with a surface of the surroundings" in finding.sentence
    assert finding.remedy == "was the object scanned too? cut it out of the `environment`"
