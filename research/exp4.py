import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
from exp1 import _curvature,_trust
def strength(A,s,m2,kappa=3.5,k=1.0):
    g=A.geometry
    mag=np.linalg.norm(g.source,axis=1).mean()/np.linalg.norm(g.detector-g.source,axis=1).mean()
    q=g.panel.pitch_u*mag
    nv=noise_var(s.p,s.photons); w=1/(nv+np.float32(m2))
    seen=s.p>0.02*np.percentile(s.p,99)
    power=float(np.mean((w*w*(nv+kappa*m2))[seen]))
    return k*np.sqrt(len(A)*power)/q, w
if __name__=="__main__":
  rows={}
  for l in open(sys.argv[1]):
    r=json.loads(l); 
    s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    best=min(q["err"] for q in r["rows"])
    beta,w=strength(A,s,r["m2"])
    V=float(np.prod(A.grid.voxel))
    x0=fast(A,p,passes=1,denoising=0.0,photons=s.photons).array.copy()
    line=[f"{r['seed']} {r['family']:9s} sart/b {r['sart'][0]/best:.2f} fast/b {r['fast']/best:.2f} x0/b {s.error(x0)/best:.2f} e {np.log2(beta*s.mu/10):.2f}"]
    for subs,tv in ((10,10),(20,4),(40,2)):
        subs=min(subs,len(A))
        _,mean=_curvature([(A[v],v) for v in subsets_of(A.geometry,subs)],_trust(A,w,None))
        errs=[]
        minimised(A,p,x0.copy(),Variation(A,beta*V/mean,tv,np.float32(0)),iterations=6,rounds=1,subsets=subs,weights=w,huber=None,mask=None,callback=lambda st: errs.append(s.error(st.volume)/best) if st.update+1==subs else None)
        line.append(f"| {subs}: "+" ".join(f"{e:.2f}" for e in errs))
    print(" ".join(line),flush=True)
