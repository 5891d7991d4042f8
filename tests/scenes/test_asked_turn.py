"""Turns asked for by an angle: where their axes are, what is refused, and what is told."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import dexnudge as dn
from dexnudge.errors import SceneError
from dexnudge.scenes.asked_turn import with_turn
from dexnudge.scenes.boxes import box
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.motion import check_asked
from dexnudge.scenes.support_contacts import support_contacts

BODY = trimesh.creation.box((0.12, 0.06, 0.02))
TABLE = box((-0.3, -0.3, -0.02), (0.3, 0.3, 0.0))
POSE = trimesh.transformations.translation_matrix([0.05, 0.02, 0.01])


def asked(environment=TABLE, pose=POSE, **options):
    return dn.Scene.from_files(BODY, environment=environment, object_pose=pose, **options)


def test_a_turn_in_place_is_about_the_centre_of_mass_and_needs_no_motion():
    scene = asked(turn_deg=-90.0)
    np.testing.assert_allclose(scene.turn.axis, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(scene.turn.point, [0.05, 0.02, 0.01], atol=1e-9)
    assert scene.turn.angle == pytest.approx(np.pi / 2)
    assert scene.motion_length == 0.0
    np.testing.assert_allclose(np.abs(scene.motion), [1, 0, 0], atol=1e-9)  # its long side
    assert repr(scene).startswith("Scene 'user': object 120 x 60 x 20 mm, 150 g, to turn by 90 deg;")


def test_a_turn_on_a_slope_is_about_the_normal_of_the_slope():
    slope = trimesh.transformations.rotation_matrix(np.radians(12.0), [0.6, 0.8, 0.0])
    scene = asked(
        TABLE.copy().apply_transform(slope), slope @ POSE, turn_deg=45.0, motion=(1, 0, 0), motion_length=0.05
    )
    np.testing.assert_allclose(scene.turn.axis, slope[:3, 2], atol=1e-6)
    assert scene.motion_length == 0.05
    velocity = scene.object_motion.twist().velocity(support_contacts(scene).points)
    np.testing.assert_allclose(velocity @ slope[:3, 2], 0.0, atol=1e-6)
    assert free_way(scene).whole


def test_beside_a_wall_a_corner_is_what_it_turns_about():
    wall = box((-0.3, -0.03, 0.0), (0.3, -0.012, 0.1))  # 2 mm from the long side
    for degrees in (60.0, -60.0):
        scene = asked(trimesh.util.concatenate([TABLE, wall]), turn_deg=degrees)
        assert free_way(scene).whole
        np.testing.assert_allclose(np.abs(scene.turn.point[:2] - POSE[:2, 3]), [0.06, 0.03], atol=1e-6)
        about = asked(trimesh.util.concatenate([TABLE, wall]), turn_deg=degrees, about=POSE[:3, 3])
        assert not free_way(about).whole
        (error,) = [finding for finding in about.findings() if finding.level == "error"]
        assert re.match(
            rf"the way of a turn by 60 deg about \(0\.00, 0\.00, {np.sign(degrees):.2f}\) through "
            r"\(0\.050, 0\.020, 0\.010\) m is blocked after [34] deg by something 100 mm high at \(.*\) m; "
            r"turn it by at most [23] deg, the other way round, or about another point by `about`$",
            error.message,
        )


@pytest.mark.parametrize(("motion", "way"), [((0, 0, -1), "90 degrees into"), ((0.3, 0, 1), "73 degrees off")])
def test_a_tip_by_a_motion_that_leads_to_no_edge_is_refused(motion, way):
    said = rf"^the motion \(.*\) leads {way} what carries the object; expected one along it; "
    with pytest.raises(SceneError, match=said + "give a `motion` toward the edge to tip over$"):
        asked(tip_deg=25.0, motion=motion)


def test_a_tip_is_over_the_edge_that_the_motion_leads_to():
    scene = asked(tip_deg=20.0, motion=(0.2, 1.0, 0.0))
    np.testing.assert_allclose(scene.motion, [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(scene.turn.axis, [-1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(scene.turn.point[1:], [0.05, 0.0], atol=1e-6)
    assert (
        "environment: the motion was turned by 11.3 deg to (0.00, 1.00, 0.00), across the edge that is tipped over"
        in (scene.notes)
    )
    np.testing.assert_allclose(scene.parameters["motion_given"], np.array([0.2, 1.0, 0.0]) / np.hypot(0.2, 1.0))
    assert free_way(scene).whole
    assert not [note for note in asked(tip_deg=20.0, motion=(0, 1, 0)).notes if "across the edge" in note]


def test_where_a_tipped_object_falls_over_by_itself():
    told = [finding.sentence for finding in asked(tip_deg=80.0, motion=(0, 1, 0)).findings()]
    over = np.degrees(np.arctan2(0.03, 0.01))
    assert (
        f"from {over:.0f} deg on the object's centre of mass is beyond the edge that it tips over: it would fall over by "
        "itself if the hand let it"
    ) in told
    told = [finding.sentence for finding in asked(tip_deg=60.0, motion=(0, 1, 0)).findings()]
    assert "its centre of mass stays behind the edge that it tips over: it falls back where the hand lets it" in told


@pytest.mark.parametrize("options", [{"turn_deg": 60.0}, {"tip_deg": 25.0, "motion": (1, 0, 0)}])
def test_a_rough_and_leaning_table_carries_a_turn(options):
    rng = np.random.default_rng(0)
    lean = trimesh.transformations.rotation_matrix(np.radians(0.5), [0.6, 0.8, 0.0])
    scan = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(TABLE.vertices, TABLE.faces, 0.008))
    scan.apply_transform(lean)
    scan.vertices += rng.normal(scale=0.001, size=(len(scan.vertices), 1)) * scan.vertex_normals
    scene = asked(scan, POSE, **options)
    axis = lean[:3, 2] if "turn_deg" in options else lean[:3, 1]
    assert scene.turn.axis @ axis > np.cos(np.radians(0.5 if "turn_deg" in options else 6.0))
    assert free_way(scene).whole
    supports = support_contacts(scene)
    velocity = scene.object_motion.twist().velocity(supports.points)
    slow = np.linalg.norm(velocity, axis=1) <= 0.02
    assert ((supports.normals * velocity).sum(axis=1)[~slow] > -1e-3).all()
    if "tip_deg" in options:
        assert slow.any()


def test_in_the_scene_of_a_family_the_slide_stays_unless_another_is_given():
    assert dn.build_scene("shelf", "phone", turn_deg=20.0).motion_length == 0.10
    scene = dn.build_scene("table", "phone", turn_deg=90.0, motion_length=0.0)
    assert scene.motion_length == 0.0
    assert dn.build_scene("turn", "phone", turn_deg=30.0).turn.angle == pytest.approx(np.radians(30.0))


NEARER = "expected at most 2 m; give a point nearer to it, in metres, or slide it"
ANGLE = "expected 0.1 to 180 degrees, either way"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"turn_deg": 0.0}, f"`turn_deg` is 0.0; {ANGLE}"),
        ({"turn_deg": -1e-9}, f"`turn_deg` is -1e-09; {ANGLE}"),
        ({"turn_deg": 181.0}, f"`turn_deg` is 181.0; {ANGLE}"),
        ({"turn_deg": float("nan")}, f"`turn_deg` is nan; {ANGLE}"),
        ({"tip_deg": -5.0, "motion": (1, 0, 0)}, "`tip_deg` is -5.0; expected 0.1 to 180 degrees"),
        ({"tip_deg": 20.0, "turn_deg": 20.0}, "`turn_deg` and `tip_deg` are both given; expected one of them"),
        (
            {"about": (0.0, 0.0, 0.0), "motion": (1, 0, 0)},
            "`about` needs `turn_deg`, the angle of the turn; add it, or leave `about` out",
        ),
        (
            {"about": (0.0, 0.0, 0.0), "motion": (1, 0, 0), "tip_deg": 20.0},
            "`about` is given with `tip_deg`; leave it out: a tip is over the edge of the support",
        ),
        (
            {"turn_deg": 20.0, "about": (50.0, 0.0, 0.0)},
            f"the axis of the turn is 49.9 m from the object; {NEARER}",
        ),
        (
            {"turn_deg": 20.0, "about": (0.0, float("nan"), 0.0)},
            "the point of a turn is (0.0, nan, 0.0); expected three finite numbers",
        ),
        (
            {"turn_deg": 20.0, "about": (0.0, 1e200, 0.0)},
            "the point of a turn is (0.0, 1e+200, 0.0); expected metres, at most 1000 from the origin",
        ),
        ({"tip_deg": 20.0}, "`tip_deg` needs `motion` too: a direction (dx, dy, dz) in the world; add it"),
        ({}, "a slide needs `motion` too: a direction (dx, dy, dz) in the world; add it"),
        (
            {"turn_deg": 20.0, "motion_length": 0.1},
            "`motion_length` 0.1 needs `motion` too: a direction (dx, dy, dz) in the world; add it",
        ),
        (
            {"turn_deg": 20.0, "motion": (1, 0, 0)},
            "`motion` is given with `turn_deg`, after which nothing slides; add `motion_length`, or leave `motion` out",
        ),
        ({"motion": (1, 0, 0), "motion_length": 0.0}, "`motion_length` is 0.0; expected a finite number > 0"),
        (
            {"motion": (1, 0, 0), "tip_deg": 20.0, "motion_length": -1.0},
            "`motion_length` is -1.0; expected a finite number >= 0",
        ),
    ],
)
def test_what_is_none_is_refused(options, message):
    with pytest.raises(SceneError) as caught:
        asked(**options)
    assert str(caught.value) == message


@pytest.mark.parametrize("value", [True, "90", None, np.inf])
def test_an_angle_that_is_no_number_is_refused(value):
    if value is None:
        assert not check_asked(turn_deg=value, tip_deg=None, about=None)
        return
    with pytest.raises(SceneError) as caught:
        check_asked(turn_deg=value, tip_deg=None, about=None)
    assert str(caught.value) == f"`turn_deg` is {value!r}; {ANGLE}"


def test_a_tip_needs_something_that_carries_the_object():
    wall = box((-0.3, -0.03, -0.1), (0.3, -0.01, 0.1))
    with pytest.raises(SceneError) as caught:
        asked(wall, tip_deg=20.0, motion=(1, 0, 0))
    assert (
        str(caught.value) == "nothing carries the object; expected a surface below it that it tips over; mend its pose"
    )


def test_a_tip_through_the_support_is_told():
    block = trimesh.util.concatenate([TABLE, box((-0.1, -0.1, 0.0), (0.06, 0.1, 0.01))])
    scene = asked(block, trimesh.transformations.translation_matrix([0.05, 0.02, 0.02]), tip_deg=40.0, motion=(1, 0, 0))
    (error,) = [finding for finding in scene.findings() if finding.level == "error"]
    assert "is blocked after 13 deg by something" in error.sentence
    assert (
        error.remedy == "tip it by at most 13 deg, over another edge by another `motion`, or make room where it sinks"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--turn", "0"], "dexnudge: --turn is 0.0; expected 0.1 to 180 degrees, either way\n"),
        (["--turn", "90", "--tip", "10"], "dexnudge: --turn and --tip are both given; expected one of them\n"),
        (
            ["--about", "0", "0", "0"],
            "dexnudge: --about needs --turn, the angle of the turn; add it, or leave --about out\n",
        ),
        (["--tip", "nan"], "dexnudge: --tip is nan; expected 0.1 to 180 degrees\n"),
    ],
)
def test_the_command_names_its_options(options, message, tmp_path, capsys):
    from dexnudge.cli.main import main

    assert main(["scene", "phone", "--scene", "table", *options, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == message
    assert not (tmp_path / "out").exists()


def test_the_command_takes_turns_in_own_surroundings(tmp_path, capsys):
    from dexnudge.cli.main import main

    TABLE.export(tmp_path / "table.stl")
    BODY.export(tmp_path / "body.stl")
    (tmp_path / "pose.json").write_text(json.dumps({"T_world_object": POSE.tolist()}))
    own = ["--environment", str(tmp_path / "table.stl"), "--object-pose", str(tmp_path / "pose.json")]
    command = ["scene", str(tmp_path / "body.stl"), *own, "--out", str(tmp_path / "out"), "--overwrite"]
    assert main([*command, "--turn", "90"]) == 0
    assert "note: the way of a turn by 90 deg about (0.00, 0.00, 1.00) through" in capsys.readouterr().out
    assert dn.load_scene(tmp_path / "out").turn.angle == pytest.approx(np.pi / 2)
    assert main([*command, "--tip", "20"]) == 2
    assert capsys.readouterr().err == "dexnudge: --environment needs --motion too; add what is missing\n"
    assert main([*command, "--tip", "20", "--motion", "1", "0", "0", "--motion-length", "0.05"]) == 0
    scene = dn.load_scene(tmp_path / "out")
    assert (scene.motion_length, np.degrees(scene.turn.angle)) == (0.05, pytest.approx(20.0))
    assert main([*command, "--turn", "20", "--motion", "1", "0", "0"]) == 2
    assert capsys.readouterr().err == (
        "dexnudge: --motion is given with --turn, after which nothing slides; add --motion-length, or leave --motion out\n"
    )
    assert main(["scene", str(tmp_path / "out"), "--turn", "90", "--out", str(tmp_path / "other")]) == 2
    assert "--turn given with the scene of the folder" in capsys.readouterr().err


def test_no_turn_leaves_the_scene_itself():
    scene = asked(motion=(1, 0, 0))
    assert with_turn(scene) is scene
    assert replace(scene, turn=None).object_motion.length == scene.motion_length
