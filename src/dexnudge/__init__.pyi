# The public names. `__init__.py` imports them from where they are said to be here, on first use.

from dexnudge.arms.arm import Arm as Arm, JointLimits as JointLimits
from dexnudge.arms.mounting import default_mount as default_mount, mount as mount
from dexnudge.arms.registry import load_arm as load_arm
from dexnudge.arms.robot import Robot as Robot
from dexnudge.arms.standing import default_base as default_base
from dexnudge.dataset.loading import Dataset as Dataset, load_dataset as load_dataset
from dexnudge.energies.terms import EnergyTerm as EnergyTerm, find_term as find_term
from dexnudge.errors import (
    ArmError as ArmError,
    CheckpointError as CheckpointError,
    DatasetError as DatasetError,
    DexnudgeError as DexnudgeError,
    HandError as HandError,
    InputError as InputError,
    MeshError as MeshError,
    OutputError as OutputError,
    PlanningError as PlanningError,
    SceneError as SceneError,
    UnknownNameError as UnknownNameError,
)
from dexnudge.execution.episode import Episode as Episode, execute as execute
from dexnudge.geometry.meshes import load_environment as load_environment, load_mesh as load_mesh
from dexnudge.hands.batch import HandBatch as HandBatch
from dexnudge.hands.export import export_hand as export_hand
from dexnudge.hands.closing import Closing as Closing
from dexnudge.hands.hand import Hand as Hand
from dexnudge.hands.preparation import PreparedHand as PreparedHand, prepare_hand as prepare_hand
from dexnudge.hands.registry import load_hand as load_hand
from dexnudge.mechanics.contacts import HandContacts as HandContacts
from dexnudge.objects.builtin import builtin_names as builtin_names, builtin_object as builtin_object
from dexnudge.perception.depth_view import DepthView as DepthView
from dexnudge.perception.views import save_views as save_views
from dexnudge.perception.views import load_views as load_views
from dexnudge.planning.outcomes import Outcome as Outcome
from dexnudge.planning.reach import Reach as Reach
from dexnudge.planning.reach_term import ReachTerm as ReachTerm
from dexnudge.results.checking import Check as Check, check as check
from dexnudge.results.folder import load_samples as load_samples
from dexnudge.results.samples import Sample as Sample, Samples as Samples
from dexnudge.sampling.sampler import Sampler as Sampler
from dexnudge.scenes.families import build_scene as build_scene, scene_families as scene_families
from dexnudge.finding import Finding as Finding
from dexnudge.scenes.motion import Turn as Turn
from dexnudge.scenes.scene import Scene as Scene, load_scene as load_scene
from dexnudge.scenes.uncertainty import Uncertainty as Uncertainty
from dexnudge.simulation.depth_camera import DepthCamera as DepthCamera, depth_views as depth_views
from dexnudge.simulation.feedback import Feedback as Feedback
from dexnudge.simulation.feedback_limits import FeedbackLimits as FeedbackLimits
from dexnudge.simulation.open_loop import OpenLoop as OpenLoop
from dexnudge.simulation.policy import (
    Command as Command,
    HandDrive as HandDrive,
    Observation as Observation,
    Policy as Policy,
    PushPlan as PushPlan,
)
from dexnudge.trajectories.base_map import BaseMap as BaseMap, find_base as find_base
from dexnudge.trajectories.plan import JointTrajectory as JointTrajectory, Phase as Phase, Plan as Plan
from dexnudge.trajectories.plan_episode import PlanEpisode as PlanEpisode
from dexnudge.trajectories.plan_folder import load_plan as load_plan
from dexnudge.trajectories.planner import Failure as Failure, plan as plan
from dexnudge.verification.criteria import (
    Criterion as Criterion,
    CriterionResult as CriterionResult,
    default_criteria as default_criteria,
    find_criterion as find_criterion,
)
from dexnudge.verification.measurements import Measurements as Measurements, measure as measure
from dexnudge.verification.penetration import Penetrations as Penetrations
from dexnudge.verification.verdicts import Verdicts as Verdicts, verify as verify
from dexnudge.version import __version__ as __version__
