# What the package offers, and where each of it lives: the one list of it, read by __init__.py and by type checkers.
from . import live as live
from ._core import Cauchy as Cauchy
from ._core import GemanMcClure as GemanMcClure
from ._core import Huber as Huber
from ._core import NlosMixture as NlosMixture
from ._core import RangeBlock as RangeBlock
from ._core import RangeSlot as RangeSlot
from ._core import Squared as Squared
from ._core import UserPose as UserPose
from .data.ranges import Ranges as Ranges
from .data.recording import Recording as Recording
from .data.registration import Registration as Registration
from .data.registration import State as State
from .data.registration import UserRegistration as UserRegistration
from .data.track import Track as Track
from .data.user import User as User
from .errors import InputError as InputError
from .estimation.incremental.estimator import Estimator as Estimator
from .estimation.register import register as register
from .geometry import YawFrame as YawFrame
from .graph.range_factors import CalibratedUserKeys as CalibratedUserKeys
from .graph.range_factors import FixedUser as FixedUser
from .graph.range_factors import RangeBlockFactor as RangeBlockFactor
from .graph.range_factors import RangeFactor as RangeFactor
from .graph.range_factors import RangeSlotFactor as RangeSlotFactor
from .graph.range_factors import UserKeys as UserKeys
from .parameters import Parameters as Parameters

__version__: str
