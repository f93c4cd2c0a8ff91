import sys
sys.path.insert(0,"/tmp/e60")
from exp1 import *
from exp1 import _curvature, _trust
from exp2 import binv, lev
def est2(A,x,views):
    B=A[views]; Bc=B.on(A.grid.with_voxels(2*A.grid.voxel,0*A.grid.voxel),B.geometry.binned(2,2))
    r=Bc(binv(x,2))-binned(B(x),None,(2,2))[0]
    return float(np.mean(np.square(r)))
def run(seed,size):
    s=random_scan(seed,size,CACHE); A,p=s.A,s.p
    out={"seed":seed,"family":s.family,"path":s.path,"views":len(A),"photons":s.photons,"n":max(A.domain_shape)}
    best=[]
    for relax in (0.3,1.0):
        errs=[]
        sart(A,p,iterations=20,relaxation=relax,nonnegative=True,callback=lambda st: errs.append(s.error(st.volume)) if st.update+1==len(A) else None)
        best.append((min(errs),int(np.argmin(errs))+1))
    out["sart"]=min(best)
    v=fast(A,p,photons=s.photons); out["fast"]=s.error(v.array)
    nv=noise_var(p,s.photons)
    x=sart(A,p,iterations=4,relaxation=1.0,nonnegative=True).array.copy()
    some=list(range(0,len(A),max(1,len(A)//12)))
    m2=est2(A,x,some)/2; out["m2"]=m2; out["mua2"]=(s.mu*float(A.grid.voxel.mean()))**2
    out["nv"]=float(nv.mean())
    w=1/(nv+np.float32(m2))
    rt=A(s.truth)-p; out["chi_t"]=float(np.mean(np.square(rt)*w)); out["Rt"]=float(np.mean(np.square(rt)))
    V=float(np.prod(A.grid.voxel)); subs=min(10,len(A))
    parts=[(A[v],v) for v in subsets_of(A.geometry,subs)]
    _,mean=_curvature(parts,_trust(A,w,None)); rows=[]
    for e in np.arange(4,-7,-1):
        beta=10.0*2.0**e/s.mu
        reg=beta*V/mean
        x=minimised(A,p,x,Variation(A,reg,10,np.float32(0)),iterations=8,rounds=1,subsets=subs,weights=w,huber=None,mask=None,callback=None).array.copy()
        r=A(x)-p
        rows.append({"e":int(e),"err":s.error(x),"chi":float(np.mean(np.square(r)*w)),"R":float(np.mean(np.square(r)))})
        if len(rows)>3 and rows[-1]["err"]>1.6*min(q["err"] for q in rows) : break
    out["rows"]=rows
    return out
if __name__=="__main__":
    size=int(sys.argv[1])
    for seed in range(int(sys.argv[2]),int(sys.argv[3])):
        print(json.dumps(run(seed,size)),flush=True)
