"""Looks at the cameras of a light field: their places, directions and brightness, told from the views."""

from lfgpu.cameras.explanation import Explanation, explain, residual_pictures
from lfgpu.cameras.looking import Budget, Look, look
from lfgpu.cameras.reasons import Reason, reasons
from lfgpu.cameras.trust import trusted
