import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
from random_scans import _views,_grid
rng=np.random.default_rng(1); n=int(sys.argv[1]); views=180
A=__import__("twinct.recon",fromlist=["Projector"]).Projector(_views(rng,"circle",views,n),_grid(rng,n))
x=np.random.default_rng(0).random(A.domain_shape).astype(np.float32)
p=A(x)
def tm(f,k=3):
    f(); t=[]
    for _ in range(k):
        s=time.perf_counter(); f(); t.append(time.perf_counter()-s)
    return min(t)
print("panel",A.range_shape)
print("forward",tm(lambda:A(x)))
print("adjoint",tm(lambda:A.T(p)))
print("sart pass",tm(lambda:sart(A,p,iterations=1,relaxation=1.0,nonnegative=True)))
out=np.zeros_like(x)
print("back_project",tm(lambda:A.back_project(p,np.ones(views),out)))
k=A.kernels; z=x.copy();q=np.ones_like(x);dual=np.zeros((3,*x.shape),np.float32)
print("primal",tm(lambda:k.primal(z,q,dual,1/A.grid.voxel,np.float32(0),out)))
print("ascend",tm(lambda:k.ascend(out,q,1/A.grid.voxel,.1,1.8,dual)))
print("lower 10", tm(lambda:k.lower(x.copy(),1/A.grid.voxel,.01,1.8,np.float32(0),10)))
